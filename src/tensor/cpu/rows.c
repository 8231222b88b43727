#include <string.h>

#include "tensor/cpu/rows.h"

row_view rows_of(const tensor *t) {
    const int64_t R = tensor_rows(t), C = tensor_columns(t);
    if (R <= 0 || C <= 0) return (row_view){.channels = C};
    const int64_t m = C >= 128 ? 1 : 128 / C;
    row_view v = {.rows = (R + m - 1) / m, .width = C * m, .channels = C};
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
