/* torch: storages by their keys, and tensors, which are views of them. At the end views are copied into
 * contiguous arrays. */
#include <string.h>

#include "io/torch.h"

torch_storage *torch_storage_find(const torch_storages *t, const char *key) {
    torch_storage *s = t->bucket[fnv1a64(key) % TORCH_BUCKETS];
    while (s && strcmp(s->key, key)) s = s->next;
    return s;
}

torch_storage *torch_storage_named(torch_storages *t, builder *b, dtype type, const char *key,
                                   int64_t count) {
    torch_storage *s = torch_storage_find(t, key);
    if (count > INT64_MAX / 16) return build_fail(b, SHERF_BAD_FILE, "torch: a storage of impossible size");
    if (s) {
        if (s->type == type && s->count == count) return s;
        return build_fail(b, SHERF_BAD_FILE, "torch: storage %s has two sizes", key);
    }
    s = build_memory(b, 1, sizeof *s);
    if (!s) return NULL;
    torch_storage **head = &t->bucket[fnv1a64(key) % TORCH_BUCKETS];
    *s = (torch_storage){.type = type, .count = count, .key = key, .next = *head};
    *head = s;
    return s;
}

/* Copies the view. Every index that it can reach is checked against the storage first. */
static value *copy_out(builder *b, const torch_view *w) {
    const torch_storage *s = w->storage;
    int64_t n = build_count(w->rank, w->dim), last = w->offset, bytes, reach,
            unit = (int64_t)dtype_size(w->type);
    if (n < 0 || w->offset < 0) return build_fail(b, SHERF_BAD_FILE, "torch: a tensor of impossible shape");
    bool dense = true;
    for (int64_t i = w->rank - 1, step = 1; n && i >= 0; i--) {
        if (w->stride[i] < 0 || __builtin_mul_overflow(w->dim[i] - 1, w->stride[i], &reach) ||
            __builtin_add_overflow(last, reach, &last))
            return build_fail(b, SHERF_BAD_FILE, "torch: a tensor of impossible strides");
        if (w->dim[i] != 1 && w->stride[i] != step) dense = false;
        step *= w->dim[i];
    }
    if (n && (__builtin_mul_overflow(last, unit, &bytes) ||
              bytes > s->count * (int64_t)dtype_size(s->type) - unit))
        return build_fail(b, SHERF_BAD_FILE, "torch: a tensor that reaches past its storage");
    if (n && !s->data) return build_fail(b, SHERF_BAD_FILE, "torch: storage %s is missing", s->key);
    value *v = build_array(b, w->type, w->rank, w->dim);
    if (!v || !n) return v;
    const unsigned char *from = s->data + w->offset * unit;
    unsigned char *to = v->array.data;
    if (dense) {
        memcpy(to, from, (size_t)(n * unit));
        return v;
    }
    int64_t index[8] = {0}, at = 0;
    for (int64_t i = 0; i < n; i++) {
        memcpy(to + i * unit, from + at * unit, (size_t)unit);
        for (int k = w->rank - 1; k >= 0; k--) {
            at += w->stride[k];
            if (++index[k] < w->dim[k]) break;
            at -= w->stride[k] * w->dim[k];
            index[k] = 0;
        }
    }
    return v;
}

bool pickle_settle(builder *b, object *o) {
    torch_view whole = {.rank = 1, .stride = {1}};
    const torch_view *view = o->view;
    if (o->role == ROLE_STORAGE) {
        whole.storage = o->storage;
        whole.type = o->storage->type;
        whole.dim[0] = o->storage->count;
        view = &whole;
    }
    value *v = copy_out(b, view);
    if (v) o->v = *v;
    return v != NULL;
}
