/* The inner loop of our own convolutions: a block of PIXELS pixels x VECTORS vectors of outputs stays in
 * registers while inputs are added. The including file defines LANES, PIXELS and VECTORS. */
#ifndef SHERF_CONV_BLOCK_FLOAT_H
#define SHERF_CONV_BLOCK_FLOAT_H

#include "base/simd.h"

enum { OUT = LANES * VECTORS };
#define UNROLL _Pragma("GCC unroll 8")

typedef vf block_sums[PIXELS][VECTORS];

INLINE void block_clear(block_sums sum) {
    UNROLL for (int p = 0; p < PIXELS; p++) UNROLL for (int v = 0; v < VECTORS; v++) sum[p][v] = splat(0);
}

/* sum += `count` inputs of each pixel, from x on, times their weights. */
INLINE void add_inputs(const float *x, int64_t pixel, const float *w, const int count, block_sums sum) {
    numbers some[PIXELS];
    UNROLL for (int p = 0; p < PIXELS; p++) some[p] = numbers_load(x + p * pixel);
    UNROLL for (int i = 0; i < count; i++, w += OUT) {
        vf in[VECTORS];
        UNROLL for (int v = 0; v < VECTORS; v++) in[v] = load(w + v * LANES);
        UNROLL for (int p = 0; p < PIXELS; p++) {
            const vf one = number(some[p], i);
            UNROLL for (int v = 0; v < VECTORS; v++) sum[p][v] += one * in[v];
        }
    }
}

/* sum += `run` adjacent inputs of each pixel; w is [run][OUT]. */
INLINE void add_run(const float *x, int64_t pixel, const float *w, int64_t run, block_sums sum) {
    int64_t i = 0;
    for (; i + NUMBERS <= run; i += NUMBERS, w += NUMBERS * OUT) add_inputs(x + i, pixel, w, NUMBERS, sum);
    for (; i < run; i++, w += OUT) add_inputs(x + i, pixel, w, 1, sum);
}
#endif
