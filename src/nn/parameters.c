/* Stores named tensors in one block, each padded to a cache line: initial values, gradients, and moving them
 * to another memory. */
#include "nn/parameters.h"

#include <stdio.h>
#include <string.h>

#include "tensor/block.h"

enum { PAD = 16 }; /* floats: one cache line */

parameters *parameters_create(context *c) {
    return mem_zero(c, 1, sizeof(parameters));
}

void parameters_free(parameters *p) {
    if (!p) return;
    for (int i = 0; i < p->count; i++) {
        mem_free(p->item[i]->name);
        mem_free(p->item[i]);
    }
    mem_free(p->item);
    block_give(p->memory, p->values);
    block_give(p->memory, p->grads);
    mem_free(p);
}

tensor *parameter_add(context *c, parameters *p, bool buffer, int rank, const int64_t *dim,
                      const char *name_format, ...) {
    if (p->count == p->capacity) {
        int capacity = p->capacity ? 2 * p->capacity : 64;
        parameter **item = mem_grow(c, p->item, (size_t)p->capacity, (size_t)capacity, sizeof *item);
        if (!item) return NULL;
        p->item = item;
        p->capacity = capacity;
    }
    char name[256];
    va_list args;
    va_start(args, name_format);
    vsnprintf(name, sizeof name, name_format, args);
    va_end(args);
    parameter *q = mem_zero(c, 1, sizeof *q);
    if (!q) return NULL;
    q->name = mem_string(c, name);
    if (!q->name) {
        mem_free(q);
        return NULL;
    }
    q->buffer = buffer;
    q->value = (tensor){.type = T_F32, .rank = rank, .name = q->name};
    for (int i = 0; i < rank; i++) q->value.dim[i] = dim[i];
    p->item[p->count++] = q;
    return &q->value;
}

static int64_t padded(const parameter *q) {
    return (tensor_count(&q->value) + PAD - 1) / PAD * PAD;
}

sherf_status parameters_lay_out(context *c, parameters *p) {
    int64_t offset = 0;
    for (int pass = 0; pass < 2; pass++) {
        for (int i = 0; i < p->count; i++) {
            if (p->item[i]->buffer != (pass == 1)) continue;
            p->item[i]->offset = offset;
            offset += padded(p->item[i]);
        }
        if (!pass) p->trained_floats = offset;
    }
    p->total_floats = offset;
    p->values = mem_zero(c, (size_t)offset, sizeof(float));
    if (!p->values) return SHERF_NO_MEMORY;
    for (int i = 0; i < p->count; i++) p->item[i]->value.data = p->values + p->item[i]->offset;
    p->laid_out = true;
    return SHERF_OK;
}

void parameters_initialise(parameters *p, uint64_t seed) {
    for (int i = 0; i < p->count; i++) {
        const parameter *q = p->item[i];
        const int64_t n = tensor_count(&q->value);
        const uint64_t key = random_key(seed, q->name, 0);
        const double deviation = q->first.deviation;
        float *v = q->value.data;
        for (int64_t k = 0; k < n; k++)
            v[k] = deviation != 0 ? (float)(deviation * random_normal(key, (uint64_t)k)) : q->first.constant;
    }
}

sherf_status parameters_make_grads(context *c, parameters *p) {
    if (p->grads) return SHERF_OK;
    p->grads = block_take(c, p->memory, (size_t)p->trained_floats, sizeof(float));
    if (!p->grads) return SHERF_NO_MEMORY;
    for (int i = 0; i < p->count; i++) {
        parameter *q = p->item[i];
        if (q->buffer) continue;
        q->grad = q->value;
        q->grad.data = p->grads + q->offset;
        q->grad.grad = NULL;
        q->value.grad = &q->grad;
        q->value.needs_grad = true;
    }
    return SHERF_OK;
}

void parameters_zero_grads(parameters *p) {
    context quiet = {0}; /* a failure on the device is reported again when its results are read */
    if (p->grads) block_clear(&quiet, p->memory, p->grads, (size_t)p->trained_floats * sizeof(float));
}

sherf_status parameters_place(context *c, parameters *p, const tensor_memory *memory) {
    if (!memory) return SHERF_OK;
    if (p->memory || p->grads)
        return failure(c, SHERF_BAD_ARGUMENT, "weights can be moved once, and before gradients are made");
    float *values = block_take(c, memory, (size_t)p->total_floats, sizeof *values);
    if (!values) return SHERF_NO_MEMORY;
    sherf_status status = memory->upload(c, values, p->values, (size_t)p->total_floats * sizeof *values);
    if (status != SHERF_OK) {
        memory->source.give(values);
        return status;
    }
    mem_free(p->values);
    p->values = values;
    p->memory = memory;
    for (int i = 0; i < p->count; i++) {
        p->item[i]->value.data = values + p->item[i]->offset;
        p->item[i]->value.memory = memory;
    }
    return SHERF_OK;
}

sherf_status parameters_read(context *c, const parameters *p, const float **values, float **copy) {
    *values = p->values;
    *copy = NULL;
    if (!p->memory) return SHERF_OK;
    *values = *copy = mem_alloc(c, (size_t)p->total_floats, sizeof **copy);
    if (!*copy) return SHERF_NO_MEMORY;
    return block_download(c, p->memory, *copy, p->values, (size_t)p->total_floats * sizeof **copy);
}

parameter *parameter_find(const parameters *p, const char *name) {
    for (int i = 0; i < p->count; i++)
        if (!strcmp(p->item[i]->name, name)) return p->item[i];
    return NULL;
}

int64_t parameters_trained_count(const parameters *p) {
    int64_t n = 0;
    for (int i = 0; i < p->count; i++)
        if (!p->item[i]->buffer) n += tensor_count(&p->item[i]->value);
    return n;
}
