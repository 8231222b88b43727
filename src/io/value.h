/* value: one tree for all external data: JSON, pickles, npy, npz, torch files. Data only. */
#ifndef SHERF_VALUE_H
#define SHERF_VALUE_H

#include "tensor/tensor.h"

typedef enum {
    VALUE_NONE,
    VALUE_BOOL,
    VALUE_INTEGER,
    VALUE_REAL,
    VALUE_STRING,
    VALUE_ARRAY,
    VALUE_LIST,
    VALUE_DICT,
    VALUE_RECORD
} value_kind;

typedef struct value value;
typedef struct {
    value *key, *item;
} value_pair;
struct value {
    value_kind kind;
    union {
        bool boolean;
        int64_t integer;
        double real;
        struct {
            const char *text;
            size_t length;
        } string; /* also bytes; a 0 follows the text */
        struct {
            dtype type;
            int rank;
            int64_t dim[8];
            void *data;
        } array; /* contiguous, row-major, little endian; rank 0 to 8 */
        struct {
            value **item;
            size_t count;
        } list; /* list, tuple, set */
        struct {
            value_pair *pair;
            size_t count;
        } dict;
        /* An object of a class that is not built: its class "module.name", its constructor's arguments, its
         * state. */
        struct {
            const char *class_name;
            value *arguments, *state;
        } record;
    };
};

/* All values of one file live in one document. */
typedef struct document document;
struct document {
    arena *memory;
    value *root;
};
void document_free(document *d); /* NULL is fine; frees d */

/* Lookups; NULL: it is missing, or d is not a dict (a record's state dict is searched as well). */
const value *value_get(const value *d, const char *key);
const value *value_at(const value *list, size_t i);
size_t value_count(const value *v); /* list, dict */
/* A one-element list (a 0-d or 1-long object array) gives its element; NULL is fine. */
const value *value_unwrapped(const value *v);
bool value_is_string(const value *v, const char *text);
/* Numbers from an array, a (nested) list of numbers, or a number: exactly `count` values, as float/double;
 * fails unless they are finite. `what` names it in the message. */
sherf_status value_floats(context *c, const value *v, const char *what, size_t count, float *out);
sherf_status value_doubles(context *c, const value *v, const char *what, size_t count, double *out);
sherf_status value_integer(context *c, const value *v, const char *what, int64_t *out);
/* Number i of an array of any type, without bounds check. */
double value_array_number(const value *v, int64_t i);
/* Number of scalars in an array or nested list; -1: v is neither. */
int64_t value_numbers(const value *v);

/* Readers; each refuses unknown data with a one-line message that names the file. */
sherf_status json_read(context *c, const char *path, document **out);
sherf_status json_parse(context *c, const char *text, size_t bytes, document **out);
/* Protocols 0-5, numpy, scipy.sparse, chumpy, torch's legacy storages; unknown classes as records. */
sherf_status pickle_parse(context *c, const unsigned char *data, size_t bytes, document **out);
sherf_status npy_read(context *c, const char *path,
                      document **out); /* also object arrays: a pickled dict is returned as the dict */
sherf_status npy_parse(context *c, const unsigned char *data, size_t bytes, document **out);
sherf_status npz_read(context *c, const char *path, document **out);   /* dict name -> array */
sherf_status torch_read(context *c, const char *path, document **out); /* zip or legacy torch.save */
/* Reads any of the above, safetensors, and OpenCV's YAML, by content. `kind` (may be NULL): "json", "pickle",
 * ... static. */
sherf_status document_read(context *c, const char *path, document **out, const char **kind);
sherf_status document_parse(context *c, const unsigned char *data, size_t bytes, document **out,
                            const char **kind);

/* float32 .npy, written completely or not at all. */
sherf_status npy_write_f32(context *c, const char *path, int rank, const int64_t *dim, const float *data);
/* npz with float32 members, or with a text (ASCII; rank 0; dim and data are ignored). */
typedef struct {
    const char *name;
    int rank;
    int64_t dim[5];
    const float *data;
    const char *text;
} npz_member;
sherf_status npz_write(context *c, const char *path, int count, const npz_member *member);
#endif
