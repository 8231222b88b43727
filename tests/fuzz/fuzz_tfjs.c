/* Fuzz target: TensorFlow.js models. */
#include <string.h>

#include "fuzz.h"
#include "io/tfjs.h"

/* The input is model.json, a 0 byte, and the contents of its files; each file is as long as its name says. */
typedef struct {
    const uint8_t *data;
    size_t size;
} files;

static sherf_status next_file(void *user, context *c, const char *path, size_t limit_bytes,
                              unsigned char **data, size_t *bytes) {
    files *f = user;
    size_t n = (size_t)(unsigned char)path[0] * 4;
    if (path[0] == '/' || strstr(path, "..")) abort();
    n = n < f->size ? n : f->size;
    if (n > limit_bytes) return failure(c, SHERF_BAD_FILE, "%s: too long", path);
    if (!(*data = mem_alloc(c, n + 1, 1))) return SHERF_NO_MEMORY;
    memcpy(*data, f->data, n);
    *bytes = n;
    f->data += n;
    f->size -= n;
    return SHERF_OK;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    const uint8_t *end = size ? memchr(data, 0, size) : NULL;
    size_t length = end ? (size_t)(end - data) : size;
    files rest = {data + length + (end != NULL), size - length - (end != NULL)};
    document *json, *arrays = NULL;
    sherf_status status = json_parse(c, (const char *)data, length, &json);
    if (status != SHERF_OK) return fuzz_document(c, status, json, live);
    tfjs_layer(json->root, "Conv2D", "conv1");
    if (tfjs_is(json->root))
        status = tfjs_arrays(c, json->root, next_file, &rest, &arrays);
    else
        status = failure(c, SHERF_MISMATCH, "no TensorFlow.js model");
    document_free(json);
    return fuzz_document(c, status, arrays, live);
}
