/* convert: sherf_convert, and what all kinds of input share: the tensors and metadata to write. */
#ifndef SHERF_CONVERT_H
#define SHERF_CONVERT_H

#include "io/safetensors.h"
#include "io/value.h"

typedef struct {
    context *c;
    arena *memory;
    safetensor_item *item;
    size_t count, room;
    safetensor_metadata metadata[24];
    size_t metadata_count;
} conversion;

/* The text is kept until the file is written; NULL: out of memory. */
char *convert_text(conversion *o, const char *format, ...) PRINTF_LIKE(2, 3);
void *convert_memory(conversion *o, int64_t count, size_t size);
/* Adds metadata; said NULL: does nothing. */
void convert_describe(conversion *o, const char *key, const char *said);
/* Adds a tensor; its data and name must stay until the file is written. */
sherf_status convert_add(conversion *o, const char *name, dtype type, int rank, const int64_t *dim,
                         const void *data);

/* convert_resnet50.c: the first stages of an ImageNet ResNet-50 as a TensorFlow.js layers model; `root` is
 * its model.json, in `folder`. */
sherf_status convert_resnet50(conversion *o, const value *root, char *folder, char **said);
/* convert_graph.c: any TensorFlow.js graph model as nodes of nn/graph.h: metadata graph.NAME, and weights
 * NAME/.... Unknown nodes are refused by name. */
sherf_status convert_graph(conversion *o, const value *root, const char *name, char *folder);
#endif
