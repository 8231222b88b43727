/* build: making value trees. Readers take memory for values from a builder. Its limit grows with the file, so
 * a small hostile file cannot claim much. Errors stick to the builder. */
#ifndef SHERF_BUILD_H
#define SHERF_BUILD_H

#include "io/value.h"

enum { BUILD_NESTING = 256 }; /* levels of a finished tree: readers of trees may recurse */

typedef struct {
    context *c;
    arena *memory;
    sherf_status status; /* the first error */
    size_t used, limit;  /* bytes */
    char *slab;          /* small pieces are cut from here */
    size_t slab_left;
    struct object *none, *truth[2];
} builder;

/* A value's role while it is being read. */
typedef enum {
    ROLE_PLAIN,
    ROLE_BORROWED, /* VALUE_STRING whose text is in the input */
    ROLE_CLASS,    /* a class or function by name: VALUE_RECORD without arguments */
    ROLE_DTYPE,    /* of numpy */
    ROLE_STORAGE,  /* of torch */
    ROLE_TENSOR    /* of torch, a view of a storage */
} object_role;

/* A numpy element type: kind as in its descriptor (b i u f c S U V O M m), size in bytes. */
typedef struct {
    char kind;
    int64_t size;
    bool big_endian;
} numpy_type;

/* The bytes of a torch storage, known at once (zip, embedded streams) or later (legacy streams). */
typedef struct torch_storage torch_storage;
struct torch_storage {
    dtype type;
    int64_t count;
    const unsigned char *data; /* NULL: not read yet */
    const char *key;
    torch_storage *next;
};

typedef struct {
    torch_storage *storage;
    dtype type;
    int64_t offset, stride[8];
    int rank;
    int64_t dim[8];
} torch_view;

typedef struct object {
    value v; /* first: a value * made here is an object * */
    uint8_t role, colour;
    int height;      /* levels below, once it is finished */
    size_t capacity; /* of a list or dict */
    union {
        numpy_type numpy;
        torch_storage *storage;
        torch_view *view;
    };
} object;

/* limit: bytes that values may take. */
bool build_start(builder *b, context *c, size_t limit);
/* Hands the tree over, or frees everything and returns the builder's status. */
sherf_status build_finish(builder *b, value *root, document **out);
/* Stores the first error; returns NULL so that `return build_fail(...)` reads well. */
void *build_fail(builder *b, sherf_status status, const char *format, ...) PRINTF_LIKE(3, 4);

/* All return NULL on failure and do nothing when the builder has failed. */
void *build_memory(builder *b, size_t count, size_t size);
value *build_value(builder *b, value_kind kind);
value *build_integer(builder *b, int64_t i);
value *build_real(builder *b, double r);
value *build_bool(builder *b, bool truth);
value *build_none(builder *b);
value *build_string(builder *b, const char *text, size_t length); /* copied */
bool build_append(builder *b, value *list, value *item);
bool build_pair(builder *b, value *dict, value *key, value *item);
bool build_entry(builder *b, value *dict, const char *key, value *item);
/* An array of rank 0..8, data not initialised; dims are checked. */
value *build_array(builder *b, dtype type, int rank, const int64_t *dim);
/* Product of dims, or -1 when a dim is negative or the product is too large. */
int64_t build_count(int rank, const int64_t *dim);

/* numpy (numpy.c; files: npy.c). */
bool numpy_type_parse(const char *text, size_t length, numpy_type *out);
/* An array (or, of kinds S and U, strings) of the elements at data; exactly count * size bytes. fortran: the
 * first index runs fastest. Booleans become U8; i1, i2, u2 I32; u4 and u8 I64. */
value *numpy_array(builder *b, numpy_type type, int rank, const int64_t *dim, bool fortran,
                   const unsigned char *data, size_t bytes);
/* Items in the shape of an object array: rank 0 the item itself, else nested lists. */
value *numpy_objects(builder *b, int rank, const int64_t *dim, bool fortran, value **item, size_t count);
/* Writes the header of an npy file of the type `descr` ("<f4"); returns its length, a multiple of 64. */
size_t npy_header_text(const char *descr, int rank, const int64_t *dim, char out[256]);
/* A whole npy file. */
value *npy_build(builder *b, const unsigned char *data, size_t bytes);

/* pickle (pickle.c). What torch's parts of a pickle refer to. */
typedef struct pickle_source {
    /* Finds or makes a storage; NULL: the pickle is not from a torch file. */
    torch_storage *(*storage)(void *user, builder *b, dtype type, const char *key, int64_t count);
    void *user;
    /* Reads an embedded stream of torch.save: torch_legacy_build. */
    value *(*stream)(builder *b, const unsigned char *data, size_t bytes, int level);
    int level; /* nesting of such streams */
} pickle_source;
/* Builds one pickle at the start of data; *used (may be NULL) gets its length. The result is not finished:
 * views of storages are still open until pickle_finish. */
value *pickle_build(builder *b, const unsigned char *data, size_t bytes, const pickle_source *source,
                    size_t *used);
/* A finished pickle that is not from a torch file (pickle_file.c). */
value *pickle_whole(builder *b, const unsigned char *data, size_t bytes);
/* Makes plain values of everything that root reaches, once all storages exist. */
value *pickle_finish(builder *b, value *root);

/* torch (torch_legacy.c). A legacy stream; the result is not finished. */
value *torch_legacy_build(builder *b, const unsigned char *data, size_t bytes, int level);

/* safetensors as a dict of name to array, and "__metadata__" (safetensors.c). */
sherf_status safetensors_document(context *c, const char *path, document **out);
sherf_status safetensors_document_parse(context *c, const void *data, size_t bytes, document **out);

/* zlib (inflate.c). Unpacks to at most build_limit of the input; *out is mem_free'd by the caller. */
bool zlib_is(const unsigned char *data, size_t bytes);
sherf_status zlib_unpack(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                         size_t *length);

/* gzip, xz, bzip2, lzma, zstd (unpack.c): the kind's name, NULL for other data. Unpack as with zlib_unpack.
 */
const char *packed_kind(const unsigned char *data, size_t bytes);
sherf_status packed_unpack(context *c, const unsigned char *data, size_t bytes, unsigned char **out,
                           size_t *length);

/* OpenCV's YAML as a dict (opencv_yaml.c): matrices as arrays, lists, numbers, texts. */
bool opencv_yaml_is(const unsigned char *data, size_t bytes); /* by its first line */
value *opencv_yaml_build(builder *b, const char *text, size_t bytes);
sherf_status opencv_yaml_parse(context *c, const unsigned char *data, size_t bytes, document **out);

/* The memory that a reader may use for an input of this many bytes. */
size_t build_limit(size_t input_bytes);
#endif
