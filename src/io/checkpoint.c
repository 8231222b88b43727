/* checkpoint: modules and state dicts to flat lists of tensors. */
#include <stdio.h>
#include <string.h>

#include "io/build.h"
#include "io/checkpoint.h"

enum { CHECKPOINT_VISITS = 1 << 20, NAME_LENGTH = 512, MODULE_DEPTH = 64 };

void named_arrays_free(named_arrays *n) {
    if (n->memory) arena_free(n->memory);
    mem_free(n->item);
    *n = (named_arrays){0};
}

const value *named_arrays_find(const named_arrays *n, const char *name) {
    for (size_t i = 0; i < n->count; i++)
        if (!strcmp(n->item[i].name, name)) return n->item[i].array;
    return NULL;
}

bool named_arrays_has_shape(const named_arrays *n, const char *name, int rank, const int64_t *dim) {
    const value *v = named_arrays_find(n, name);
    if (!v || v->array.rank != rank) return false;
    for (int i = 0; i < rank; i++)
        if (v->array.dim[i] != dim[i]) return false;
    return true;
}

static sherf_status add(named_arrays *n, const char *name, const value *array) {
    if (named_arrays_find(n, name))
        return failure(n->c, SHERF_BAD_FILE, "tensor %.200s is there twice", name);
    if (n->count == n->room) {
        size_t room = n->room ? n->room * 2 : 256;
        named_array *grown = mem_grow(n->c, n->item, n->count, room, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        n->item = grown;
        n->room = room;
    }
    size_t length = strlen(name) + 1;
    char *copy = arena_alloc(n->c, n->memory, length, 1);
    if (!copy) return SHERF_NO_MEMORY;
    memcpy(copy, name, length);
    n->item[n->count++] = (named_array){copy, array};
    return SHERF_OK;
}

static sherf_status start(context *c, named_arrays *n) {
    *n = (named_arrays){.c = c, .memory = arena_create(c)};
    return n->memory ? SHERF_OK : SHERF_NO_MEMORY;
}

/* Appends prefix + key to name; false if it is too long or the key is not plain text. */
static bool extend(char name[NAME_LENGTH], size_t length, const value *key) {
    if (key->kind != VALUE_STRING || !key->string.length) return false;
    size_t n = key->string.length, dot = length ? 1 : 0;
    if (length + dot + n >= NAME_LENGTH) return false;
    for (size_t i = 0; i < n; i++)
        if (key->string.text[i] <= ' ' || key->string.text[i] > '~') return false;
    if (dot) name[length] = '.';
    memcpy(name + length + dot, key->string.text, n + 1);
    return true;
}

bool module_is(const value *v) {
    return v && v->kind == VALUE_RECORD && value_get(v, "_parameters") && value_get(v, "_modules");
}

static sherf_status flatten(named_arrays *out, const value *module, char name[NAME_LENGTH], int depth) {
    static const char *const own[] = {"_parameters", "_buffers"};
    size_t length = strlen(name);
    context *c = out->c;
    if (++out->visits > CHECKPOINT_VISITS || depth > MODULE_DEPTH)
        return failure(c, SHERF_BAD_FILE, "modules without end");
    for (size_t k = 0; k < COUNT_OF(own); k++) {
        const value *d = value_get(module, own[k]);
        if (!d || d->kind != VALUE_DICT) continue;
        for (size_t i = 0; i < d->dict.count; i++) {
            const value *item = d->dict.pair[i].item;
            if (++out->visits > CHECKPOINT_VISITS) return failure(c, SHERF_BAD_FILE, "modules without end");
            if (item->kind != VALUE_ARRAY) continue; /* None: a layer without a bias */
            if (!extend(name, length, d->dict.pair[i].key))
                return failure(c, SHERF_BAD_FILE, "module %.200s: a parameter without a proper name", name);
            sherf_status status = add(out, name, item);
            if (status != SHERF_OK) return status;
            name[length] = 0;
        }
    }
    const value *inner = value_get(module, "_modules");
    if (!inner || inner->kind != VALUE_DICT) return SHERF_OK;
    for (size_t i = 0; i < inner->dict.count; i++) {
        const value *item = inner->dict.pair[i].item;
        if (++out->visits > CHECKPOINT_VISITS) return failure(c, SHERF_BAD_FILE, "modules without end");
        if (!module_is(item)) continue;
        if (!extend(name, length, inner->dict.pair[i].key))
            return failure(c, SHERF_BAD_FILE, "module %.200s: a part without a proper name", name);
        sherf_status status = flatten(out, item, name, depth + 1);
        if (status != SHERF_OK) return status;
        name[length] = 0;
    }
    return SHERF_OK;
}

sherf_status module_flatten(context *c, const value *module, named_arrays *out) {
    char name[NAME_LENGTH] = "";
    sherf_status status = start(c, out);
    if (status == SHERF_OK) status = flatten(out, module, name, 0);
    if (status != SHERF_OK) named_arrays_free(out);
    return status;
}

/* The dict with most of the tensors: root itself or the one under a usual name. */
static const value *state_dict_in(const value *root) {
    static const char *const usual[] = {"state_dict", "model_state_dict", "model", "net", "params"};
    for (size_t i = 0; i < COUNT_OF(usual); i++) {
        const value *v = value_get(root, usual[i]);
        if (v && (v->kind == VALUE_DICT || module_is(v))) return v;
    }
    return root;
}

sherf_status state_dict_flatten(context *c, const value *root, named_arrays *out) {
    const value *d = module_is(root) ? root : state_dict_in(root);
    *out = (named_arrays){0};
    if (module_is(d)) return module_flatten(c, d, out);
    if (!d || d->kind != VALUE_DICT) return failure(c, SHERF_BAD_FILE, "no dict of tensors");
    sherf_status status = start(c, out);
    for (size_t i = 0; status == SHERF_OK && i < d->dict.count; i++) {
        char name[NAME_LENGTH] = "";
        const value *item = d->dict.pair[i].item;
        if (item->kind != VALUE_ARRAY || !extend(name, 0, d->dict.pair[i].key)) continue;
        if (out->count >= 1 << 16) status = failure(c, SHERF_BAD_FILE, "too many tensors");
        if (status == SHERF_OK) status = add(out, strncmp(name, "module.", 7) ? name : name + 7, item);
    }
    if (status == SHERF_OK && !out->count) status = failure(c, SHERF_BAD_FILE, "no dict of tensors");
    if (status != SHERF_OK) named_arrays_free(out);
    return status;
}
