/* Rows of channels for the CPU kernels. Narrow rows (few channels) are processed several at a time, so that
 * inner loops are long enough for SIMD: a tensor [R, C] is viewed as `rows` rows of `width` = C * m values,
 * `last` values in the last row; values of a channel are repeated m times. Sums over rows run block by block.
 * The blocks depend only on the shape, so results do not depend on the thread count. */
#ifndef SHERF_CPU_ROWS_H
#define SHERF_CPU_ROWS_H

#include "tensor/cpu/cpu.h"

typedef struct {
    int64_t rows, width, last;
    int64_t channels;
    int64_t block_rows, blocks;
} row_view;

row_view rows_of(const tensor *t);
static inline int64_t row_width(const row_view *v, int64_t row) {
    return row + 1 < v->rows ? v->width : v->last;
}
/* The number of rows that makes a range of parallel_for worth a thread. */
static inline int64_t row_grain(const row_view *v) {
    return 1 + (1 << 14) / (v->width + 1);
}
/* channel[C], repeated over the view's width, in the call's scratch; zeros for NULL. NULL: no memory. */
float *row_pattern(op_call *call, const row_view *v, const float *channel);
/* Scratch for `kinds` sums of each block: [blocks][kinds][width], not zeroed. */
float *block_sums(op_call *call, const row_view *v, int kinds);
/* to[c] += factor * the sum over blocks of one kind (and over the repetitions), in a fixed order. */
void block_sums_add(const row_view *v, const float *sums, int kinds, int kind, float factor, float *to);
/* to[c] += factor * the sum over x's rows. */
sherf_status column_sums_add(op_call *call, const tensor *x, float factor, float *to);
/* to[i] += factor * from[i], or = with `fresh`, over the context's threads. */
void cpu_add_scaled(const context *c, int64_t n, float factor, const float *from, bool fresh, float *to);
#endif
