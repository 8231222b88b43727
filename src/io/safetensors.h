/* safetensors: 8-byte header length, JSON header, tensors. https://github.com/huggingface/safetensors
 * (format) */
#ifndef SHERF_SAFETENSORS_H
#define SHERF_SAFETENSORS_H

#include "tensor/tensor.h"

/* The reader is strict. It refuses a header that does not fit, data that overlaps or leaves holes, repeated
 * names, and unknown types or ranks. BOOL is read as U8. */
typedef struct {
    char *name;
    dtype type;
    int rank;
    int64_t dim[TENSOR_RANK];
    const void *data; /* 64-byte aligned */
} safetensor;
typedef struct {
    size_t count;
    safetensor *tensor; /* in file order */
    size_t metadata_count;
    char **metadata_key, **metadata_value;
    void *memory; /* internal: the arena that owns all this */
    size_t memory_bytes;
} safetensors;
sherf_status safetensors_read(context *c, const char *path, safetensors **out);
/* The same from memory, which may be freed afterwards. */
sherf_status safetensors_parse(context *c, const void *data, size_t bytes, safetensors **out);
void safetensors_free(safetensors *s);
const safetensor *safetensors_find(const safetensors *s, const char *name);
const char *safetensors_metadata(const safetensors *s, const char *key);
/* float32 values of a tensor of exactly this shape (F32, F64, F16, BF16 in the file), into out. */
sherf_status safetensors_floats(context *c, const safetensors *s, const char *name, int rank,
                                const int64_t *dim, float *out);

/* If the first piece of metadata is "crc32", it is the checksum of all the file's bytes, with its own eight
 * digits taken as zeros; the reader refuses a file whose bytes give another one. */
#define SAFETENSORS_CHECKSUM                                                                                 \
    { "crc32", NULL } /* as the first piece of metadata: the writer fills it in */

/* Writing: tensors in the order given; data start 64-byte aligned; whole or not at all. */
typedef struct {
    const char *name;
    dtype type;
    int rank;
    int64_t dim[TENSOR_RANK];
    const void *data;
} safetensor_item;
typedef struct {
    const char *key, *value;
} safetensor_metadata;
sherf_status safetensors_write(context *c, const char *path, size_t count, const safetensor_item *item,
                               size_t metadata_count, const safetensor_metadata *metadata);
#endif
