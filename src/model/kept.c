/* What an avatar keeps of an encoded observation: named arrays, from the bank and from files. */
#include <string.h>

#include "model/model.h"

void kept_free(kept_bank *k) {
    for (int i = 0; i < k->count; i++) mem_free(k->array[i].data);
    *k = (kept_bank){0};
}

sherf_status kept_take(context *c, const tensor *x, kept_array *out) {
    if (x->rank != out->rank)
        return failure(c, SHERF_BAD_ARGUMENT, "the bank's %s has another rank", out->name);
    for (int i = 0; i < x->rank; i++) out->dim[i] = x->dim[i];
    out->data = mem_alloc(c, (size_t)tensor_count(x), sizeof(float));
    return out->data ? tensor_download(c, x, out->data) : SHERF_NO_MEMORY;
}

sherf_status kept_make(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                       kept_bank *out) {
    const model_kind *kind = m->config.kind;
    kind->kept(&m->config, out);
    if (kind->keep) return kind->keep(c, m, g, bank, out);
    sherf_status status = SHERF_OK;
    for (int i = 0; i < out->count && status == SHERF_OK; i++)
        status = kept_take(c, bank->tensor[i], &out->array[i]);
    return status;
}

sherf_status kept_array_read(context *c, const safetensors *s, kept_array *k) {
    const safetensor *t = safetensors_find(s, k->name);
    if (!t || t->rank != k->rank || (k->type == T_I32 && t->type != T_I32))
        return failure(c, SHERF_BAD_FILE, "tensor %s is missing or of the wrong shape", k->name);
    size_t count = 1;
    for (int i = 0; i < k->rank; i++) {
        if (k->dim[i] && t->dim[i] != k->dim[i])
            return failure(c, SHERF_BAD_FILE, "tensor %s is missing or of the wrong shape", k->name);
        k->dim[i] = t->dim[i];
        if (k->dim[i] < 1 || k->dim[i] > 1 << 24)
            return failure(c, SHERF_BAD_FILE, "tensor %s: bad size", k->name);
        count *= (size_t)k->dim[i];
    }
    k->data = mem_alloc(c, count, sizeof(float));
    if (!k->data) return SHERF_NO_MEMORY;
    if (k->type == T_F32) return safetensors_floats(c, s, k->name, k->rank, k->dim, k->data);
    memcpy(k->data, t->data, count * sizeof(int32_t));
    return SHERF_OK;
}

sherf_status kept_read(context *c, const safetensors *s, const model_config *config, kept_bank *out) {
    sherf_status status = SHERF_OK;
    config->kind->kept(config, out);
    for (int i = 0; i < out->count && status == SHERF_OK; i++) status = kept_array_read(c, s, &out->array[i]);
    return status;
}
