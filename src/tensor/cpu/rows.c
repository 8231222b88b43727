/* Views tensors as wide rows, and sums over rows: in float within a block, in double over the blocks. */
#include <string.h>

#include "tensor/cpu/rows.h"
#include "tensor/cpu/variants.h"

row_view rows_of(const tensor *t) {
    const int64_t R = tensor_rows(t), C = tensor_columns(t);
    if (R <= 0 || C <= 0) return (row_view){.channels = C};
    const int64_t fold = C >= 128 ? 1 : 128 / C;
    row_view v = {.rows = (R + fold - 1) / fold, .width = C * fold, .channels = C};
    v.last = R * C - (v.rows - 1) * v.width;
    const int64_t few = (1 << 14) / v.width + 1, many = (v.rows + 255) / 256; /* 64 KiB; 256 blocks */
    v.block_rows = few > many ? few : many;
    v.blocks = (v.rows + v.block_rows - 1) / v.block_rows;
    return v;
}

float *row_pattern(op_call *call, const row_view *v, const float *channel) {
    float *pattern = arena_alloc(call->c, call->scratch, (size_t)v->width, sizeof *pattern);
    for (int64_t i = 0; pattern && i < v->width; i++) pattern[i] = channel ? channel[i % v->channels] : 0;
    return pattern;
}

float *block_sums(op_call *call, const row_view *v, int kinds) {
    return arena_alloc(call->c, call->scratch, (size_t)v->blocks * (size_t)v->width,
                       (size_t)kinds * sizeof(float));
}

void block_sums_add(const row_view *v, const float *sums, int kinds, int kind, float factor, float *to) {
    enum { CHUNK = 64 };
    for (int64_t first = 0; first < v->channels; first += CHUNK) {
        const int64_t n = v->channels - first < CHUNK ? v->channels - first : CHUNK;
        double total[CHUNK] = {0};
        for (int64_t b = 0; b < v->blocks; b++)
            for (int64_t m = first; m < v->width; m += v->channels) {
                const float *from = sums + (b * kinds + kind) * v->width + m;
                for (int64_t i = 0; i < n; i++) total[i] += from[i];
            }
        for (int64_t i = 0; i < n; i++) to[first + i] += (float)(factor * total[i]);
    }
}

typedef struct {
    row_view view;
    const float *x;
    float *sums;
} sums_job;

static VARIANT_BODY void sum_blocks(void *arg, int64_t begin, int64_t end, int thread) {
    const sums_job *j = arg;
    const row_view *v = &j->view;
    for (int64_t block = begin; block < end; block++) {
        float *restrict sum = j->sums + block * v->width;
        memset(sum, 0, (size_t)v->width * sizeof *sum);
        for (int64_t r = block * v->block_rows; r < v->rows && r < (block + 1) * v->block_rows; r++) {
            const float *restrict x = j->x + r * v->width;
            const int64_t n = row_width(v, r);
            for (int64_t i = 0; i < n; i++) sum[i] += x[i];
        }
    }
}
VARIANTS(sum_blocks)

sherf_status column_sums_add(op_call *call, const tensor *x, float factor, float *to) {
    sums_job j = {.view = rows_of(x), .x = x->data};
    if (!(j.sums = block_sums(call, &j.view, 1))) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.blocks, 1, sum_blocks_best(), &j);
    block_sums_add(&j.view, j.sums, 1, 0, factor, to);
    return SHERF_OK;
}
