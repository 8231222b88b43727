/* TensorFlow.js weights: a group's files, concatenated, are cut into arrays, and quantised numbers become
 * float32. The manifest's paths, shapes and sizes are checked before use. */
#include <limits.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "io/build.h"
#include "io/half.h"
#include "io/tfjs.h"

enum { WEIGHTS_MAX = 1 << 14, SHARDS_MAX = 1 << 12, NAME_LENGTH = 256 };
static const size_t group_bytes_max = (size_t)1 << 30;

bool tfjs_is(const value *root) {
    return value_get(root, "weightsManifest") && value_get(root, "modelTopology");
}

bool tfjs_is_graph(const value *root) {
    return tfjs_is(root) && value_is_string(value_get(root, "format"), "graph-model");
}

const value *tfjs_layer(const value *root, const char *class_name, const char *name) {
    const value *topology = value_get(root, "modelTopology");
    const value *layers = value_get(value_get(value_get(topology, "model_config"), "config"), "layers");
    for (size_t i = 0; i < value_count(layers); i++) {
        const value *layer = value_at(layers, i), *config = value_get(layer, "config");
        if (value_is_string(value_get(layer, "class_name"), class_name) &&
            value_is_string(value_get(config, "name"), name))
            return config;
    }
    return NULL;
}

/* ---- one array ---- */
typedef struct {
    const char *name;
    int rank;
    int64_t dim[8], count;
    dtype type; /* float32 or int32 */
    int size;   /* bytes of a number: 4, or 1 or 2 quantised */
    bool half;  /* float16 */
    double minimum, scale;
} weight;

static bool text_is_plain(const value *v, size_t length_max) {
    if (!v || v->kind != VALUE_STRING || !v->string.length || v->string.length >= length_max) return false;
    for (size_t i = 0; i < v->string.length; i++)
        if (v->string.text[i] <= ' ' || v->string.text[i] > '~') return false;
    return true;
}

static sherf_status quantization(context *c, const value *q, weight *w) {
    const value *type = value_get(q, "dtype");
    if (value_is_string(type, "float16")) {
        w->size = 2;
        w->half = true;
        return SHERF_OK;
    }
    w->size = value_is_string(type, "uint8") ? 1 : value_is_string(type, "uint16") ? 2 : 0;
    if (!w->size)
        return failure(c, SHERF_UNSUPPORTED,
                       "array %s: its quantization is neither float16 nor uint8 nor uint16", w->name);
    sherf_status status = value_doubles(c, value_get(q, "min"), "min of a quantization", 1, &w->minimum);
    if (status == SHERF_OK)
        status = value_doubles(c, value_get(q, "scale"), "scale of a quantization", 1, &w->scale);
    return status;
}

static sherf_status weight_parse(context *c, const value *v, weight *w) {
    const value *name = value_get(v, "name"), *shape = value_get(v, "shape"),
                *q = value_get(v, "quantization");
    *w = (weight){.type = T_F32, .size = 4};
    if (!text_is_plain(name, NAME_LENGTH))
        return failure(c, SHERF_BAD_FILE, "an array of the manifest has no proper name");
    w->name = name->string.text;
    if (value_is_string(value_get(v, "dtype"), "int32") && !q)
        w->type = T_I32;
    else if (!value_is_string(value_get(v, "dtype"), "float32"))
        return failure(c, SHERF_UNSUPPORTED, "array %s: only float32 and plain int32 are read", w->name);
    if (!shape || shape->kind != VALUE_LIST || shape->list.count > COUNT_OF(w->dim))
        return failure(c, SHERF_BAD_FILE, "array %s: its shape is no list of up to 8 sizes", w->name);
    w->rank = (int)shape->list.count;
    for (int i = 0; i < w->rank; i++) {
        sherf_status status = value_integer(c, shape->list.item[i], "a size of an array", &w->dim[i]);
        if (status != SHERF_OK) return failure_prefix(c, status, "array %s", w->name);
    }
    w->count = build_count(w->rank, w->dim);
    if (w->count < 0 || (size_t)w->count > group_bytes_max / 4)
        return failure(c, SHERF_BAD_FILE, "array %s: its shape is out of range", w->name);
    if (!q) return SHERF_OK;
    sherf_status status = quantization(c, q, w);
    return status == SHERF_OK ? status : failure_prefix(c, status, "array %s", w->name);
}

static value *weight_build(builder *b, const weight *w, const unsigned char *data) {
    value *v = build_array(b, w->type, w->rank, w->dim);
    if (!v) return NULL;
    float *out = v->array.data;
    if (w->size == 4) {
        memcpy(v->array.data, data, (size_t)w->count * 4);
        return v;
    }
    for (int64_t i = 0; i < w->count; i++) {
        unsigned stored = w->size == 1 ? data[i] : data[2 * i] | (unsigned)data[2 * i + 1] << 8;
        out[i] = w->half ? half_to_float((uint16_t)stored) : (float)(w->minimum + w->scale * stored);
    }
    return v;
}

/* ---- a group: files whose bytes, end to end, are its arrays ---- */

/* Every part is a plain name: no absolute path, no "." or "..", no other system's separators. */
static bool path_is_plain(const value *v) {
    if (!text_is_plain(v, NAME_LENGTH) || strchr(v->string.text, '\\') || strchr(v->string.text, ':'))
        return false;
    for (const char *p = v->string.text;; p++) {
        size_t n = strcspn(p, "/");
        if (!n || (n == 1 && p[0] == '.') || (n == 2 && p[0] == '.' && p[1] == '.')) return false;
        p += n;
        if (!*p) return true;
    }
}

static sherf_status read_shards(context *c, const value *paths, size_t bytes, tfjs_reader reader, void *user,
                                unsigned char **out) {
    size_t at = 0, room = 0;
    unsigned char *all = NULL, *part = NULL;
    sherf_status status = SHERF_OK;
    *out = NULL;
    if (!paths || paths->kind != VALUE_LIST || paths->list.count > SHARDS_MAX)
        return failure(c, SHERF_BAD_FILE, "the manifest's paths are no list of up to %d files", SHARDS_MAX);
    for (size_t i = 0; i < paths->list.count; i++) {
        const value *path = paths->list.item[i];
        size_t n = 0;
        if (!path_is_plain(path)) {
            status = failure(c, SHERF_BAD_FILE, "path %zu of the manifest is not one below its folder", i);
            break;
        }
        if ((status = reader(user, c, path->string.text, bytes - at, &part, &n)) != SHERF_OK) break;
        if (!all || n > room - at) { /* grows with the files: the manifest may claim too much */
            size_t wanted = n > at ? at + n + 1 : 2 * at;
            unsigned char *grown = mem_grow(c, all, at, wanted, 1);
            if (!grown) {
                status = SHERF_NO_MEMORY;
                break;
            }
            all = grown;
            room = wanted;
        }
        memcpy(all + at, part, n);
        at += n;
        mem_free(part);
        part = NULL;
    }
    if (status == SHERF_OK && at != bytes)
        status =
            failure(c, SHERF_BAD_FILE, "the manifest's files hold %zu bytes, its arrays take %zu", at, bytes);
    mem_free(part);
    if (status == SHERF_OK)
        *out = all;
    else
        mem_free(all);
    return status;
}

static sherf_status group_build(builder *b, const value *group, tfjs_reader reader, void *user, value *dict) {
    context *c = b->c;
    const value *weights = value_get(group, "weights");
    size_t bytes = 0;
    unsigned char *data = NULL;
    weight w;
    sherf_status status = SHERF_OK;
    if (!weights || weights->kind != VALUE_LIST || weights->list.count + dict->dict.count > WEIGHTS_MAX)
        return failure(c, SHERF_BAD_FILE, "the manifest's weights are no list of up to %d arrays",
                       WEIGHTS_MAX);
    for (size_t i = 0; i < weights->list.count; i++) {
        if ((status = weight_parse(c, weights->list.item[i], &w)) != SHERF_OK) return status;
        bytes += (size_t)w.count * (size_t)w.size; /* each at most 1 GiB */
        if (bytes > group_bytes_max)
            return failure(c, SHERF_BAD_FILE, "the manifest's arrays take more than %zu bytes",
                           group_bytes_max);
    }
    if ((status = read_shards(c, value_get(group, "paths"), bytes, reader, user, &data)) != SHERF_OK)
        return status;
    b->limit += 4 * bytes; /* they exist */
    for (size_t i = 0, at = 0; i < weights->list.count && status == SHERF_OK; i++) {
        status = weight_parse(c, weights->list.item[i], &w);
        if (status != SHERF_OK) break;
        value *name = build_string(b, w.name, strlen(w.name)), *array = weight_build(b, &w, data + at);
        if (!name || !array || !build_pair(b, dict, name, array)) status = b->status;
        at += (size_t)w.count * (size_t)w.size;
    }
    mem_free(data);
    return status;
}

sherf_status tfjs_arrays(context *c, const value *root, tfjs_reader reader, void *user, document **out) {
    enum { GROUPS_MAX = 1 << 10 };
    const value *manifest = value_get(root, "weightsManifest");
    builder b;
    *out = NULL;
    if (!manifest || manifest->kind != VALUE_LIST || manifest->list.count > GROUPS_MAX)
        return failure(c, SHERF_BAD_FILE, "weightsManifest is no list of up to %d groups", GROUPS_MAX);
    if (!build_start(&b, c, (size_t)64 << 20)) return b.status;
    value *dict = build_value(&b, VALUE_DICT);
    for (size_t i = 0; dict && i < manifest->list.count; i++) {
        sherf_status status = group_build(&b, manifest->list.item[i], reader, user, dict);
        if (status == SHERF_OK) continue;
        if (b.status == SHERF_OK) b.status = status;
        dict = NULL;
    }
    return build_finish(&b, dict, out);
}

sherf_status tfjs_read_below(void *folder, context *c, const char *path, size_t limit_bytes,
                             unsigned char **data, size_t *bytes) {
    char joined[PATH_LENGTH], real_folder[PATH_MAX], real_file[PATH_MAX];
    if (snprintf(joined, sizeof joined, "%s/%s", (const char *)folder, path) >= (int)sizeof joined)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", (const char *)folder);
    if (realpath(folder, real_folder) && realpath(joined, real_file)) {
        size_t n = strlen(real_folder);
        if (strncmp(real_file, real_folder, n) != 0 || (n > 1 && real_file[n] != '/'))
            return failure(c, SHERF_BAD_FILE, "%s: is a link out of its folder", joined);
    }
    return file_read(c, joined, limit_bytes, data, bytes);
}
