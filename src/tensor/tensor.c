/* Tensors: types and shapes, copies between the host and their memory, tensors on the heap. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "tensor/block.h"

static const size_t sizes[] = {
    [T_F32] = 4, [T_F64] = 8, [T_I32] = 4, [T_I64] = 8, [T_U8] = 1, [T_BF16] = 2, [T_F16] = 2};
static const char *const names[] = {[T_F32] = "F32", [T_F64] = "F64",   [T_I32] = "I32", [T_I64] = "I64",
                                    [T_U8] = "U8",   [T_BF16] = "BF16", [T_F16] = "F16"};

size_t dtype_size(dtype t) {
    return sizes[t];
}
const char *dtype_name(dtype t) {
    return names[t];
}

int64_t tensor_count(const tensor *t) {
    int64_t n = 1;
    for (int i = 0; i < t->rank; i++) n *= t->dim[i];
    return n;
}

int64_t tensor_columns(const tensor *t) {
    return t->rank ? t->dim[t->rank - 1] : 1;
}

int64_t tensor_rows(const tensor *t) {
    int64_t n = 1;
    for (int i = 0; i + 1 < t->rank; i++) n *= t->dim[i];
    return n;
}

bool tensor_same_shape(const tensor *a, const tensor *b) {
    if (a->rank != b->rank) return false;
    for (int i = 0; i < a->rank; i++)
        if (a->dim[i] != b->dim[i]) return false;
    return true;
}

void tensor_shape_text(const tensor *t, char text[64]) {
    int n = snprintf(text, 64, "[");
    for (int i = 0; i < t->rank && n < 60; i++)
        n += snprintf(text + n, 64 - (size_t)n, i ? ", %" PRId64 : "%" PRId64, t->dim[i]);
    if (n < 63) snprintf(text + n, 64 - (size_t)n, "]");
}

static size_t bytes_of(const tensor *x) {
    return (size_t)tensor_count(x) * dtype_size(x->type);
}

sherf_status tensor_upload(context *c, tensor *to, const void *from) {
    return block_upload(c, to->memory, to->data, from, bytes_of(to));
}

sherf_status tensor_download(context *c, const tensor *from, void *to) {
    return block_download(c, from->memory, to, from->data, bytes_of(from));
}

sherf_status tensor_clear(context *c, tensor *x) {
    return block_clear(c, x->memory, x->data, bytes_of(x));
}

sherf_status tensor_copy_rows(context *c, tensor *to, int64_t to_begin, const tensor *from,
                              int64_t from_begin, int64_t rows) {
    const size_t row = (size_t)tensor_columns(to) * dtype_size(to->type);
    char *target = (char *)to->data + (size_t)to_begin * row;
    const char *source = (const char *)from->data + (size_t)from_begin * row;
    return block_copy(c, to->memory, target, source, (size_t)rows * row);
}

tensor *tensor_create(context *c, dtype type, int rank, const int64_t *dim) {
    size_t count = 1;
    tensor *t = mem_zero(c, 1, sizeof *t);
    if (!t) return NULL;
    t->type = type;
    t->rank = rank;
    for (int i = 0; i < rank; i++) {
        t->dim[i] = dim[i];
        if (dim[i] < 0 || __builtin_mul_overflow(count, (size_t)dim[i], &count)) {
            failure(c, SHERF_NO_MEMORY, "out of memory: a tensor of dimension %" PRId64, dim[i]);
            mem_free(t);
            return NULL;
        }
    }
    t->data = mem_zero(c, count, dtype_size(type));
    if (!t->data) {
        mem_free(t);
        return NULL;
    }
    return t;
}

void tensor_free(tensor *t) {
    if (!t) return;
    tensor_free(t->grad);
    block_give(t->memory, t->data);
    mem_free(t);
}

sherf_status tensor_place(context *c, tensor *t, const tensor_memory *memory) {
    if (!memory) return SHERF_OK;
    void *data = block_take(c, memory, bytes_of(t), 1);
    sherf_status status = data ? memory->upload(c, data, t->data, bytes_of(t)) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) {
        block_give(memory, data);
        return status;
    }
    mem_free(t->data);
    t->data = data;
    t->memory = memory;
    return SHERF_OK;
}
