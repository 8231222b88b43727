/* Packing of AMX operands and the tile state. For cpu/amx_*.c only, on x86-64. */
#ifndef SHERF_AMX_TILES_H
#define SHERF_AMX_TILES_H

#include "base/amx.h"
#include <stdbool.h>
#include <stdint.h>

/* A tile of a product's operand is 16 rows of 16 pairs of bf16, 1 KiB: for A rows are m and pairs run along
 * k, for B rows are pairs of k and columns are n. */
enum { TILE = 512 /* bf16 values */, SIDE = 16, DEPTH = 32 /* k of a tile */ };

static inline int64_t tiles(int64_t n, int64_t side) {
    return (n + side - 1) / side;
}

AMX_INLINE __mmask16 lanes(int64_t n) {
    return n >= 16 ? 0xffff : n <= 0 ? 0 : (__mmask16)((1u << n) - 1);
}

/* Row j: 32 values of row j of m, from column 0; rows and columns outside the given ones are 0. */
AMX_INLINE void load_across(const float *m, int64_t ld, int64_t rows, int64_t columns, __m512i out[16]) {
    const __mmask16 low = lanes(columns), high = lanes(columns - 16);
    for (int j = 0; j < 16; j++) {
        if (j >= rows) {
            out[j] = _mm512_setzero_si512();
            continue;
        }
        const __m512 a = _mm512_maskz_loadu_ps(low, m + j * ld);
        const __m512 b = _mm512_maskz_loadu_ps(high, m + j * ld + 16);
        out[j] = (__m512i)_mm512_cvtne2ps_pbh(b, a);
    }
}

/* For _mm512_permutexvar_epi16: from (a0 .. a15, b0 .. b15) to a0 b0 a1 b1 .. */
AMX_INLINE __m512i pair_order(void) {
    const __m512i low = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    return _mm512_or_si512(low, _mm512_slli_epi32(_mm512_add_epi32(low, _mm512_set1_epi32(16)), 16));
}

/* Row p: the pairs (m[2p][c], m[2p + 1][c]) for 16 columns c. */
AMX_INLINE void load_down(const float *m, int64_t ld, int64_t rows, int64_t columns, __m512i out[16]) {
    const __mmask16 mask = lanes(columns);
    const __m512i order = pair_order();
    for (int p = 0; p < 16; p++) {
        const __m512 zero = _mm512_setzero_ps();
        const __m512 a = 2 * p < rows ? _mm512_maskz_loadu_ps(mask, m + 2 * p * ld) : zero;
        const __m512 b = 2 * p + 1 < rows ? _mm512_maskz_loadu_ps(mask, m + (2 * p + 1) * ld) : zero;
        out[p] = _mm512_permutexvar_epi16(order, (__m512i)_mm512_cvtne2ps_pbh(b, a));
    }
}

/* Loads tiles 0 to 3 from 2 x 2 tiles of sums in order, or zeroes them. */
AMX_INLINE void sums_begin(bool add, const float *sums) {
    if (add) {
        tile_load(0, sums, 64);
        tile_load(1, sums + 256, 64);
        tile_load(2, sums + 512, 64);
        tile_load(3, sums + 768, 64);
    } else {
        _tile_zero(0);
        _tile_zero(1);
        _tile_zero(2);
        _tile_zero(3);
    }
}

AMX_INLINE void sums_end(float *sums) {
    _tile_stored(0, sums, 64);
    _tile_stored(1, sums + 256, 64);
    _tile_stored(2, sums + 512, 64);
    _tile_stored(3, sums + 768, 64);
}

AMX_INLINE void tile_write(const __m512i v[16], uint16_t *to) {
    for (int i = 0; i < 16; i++) _mm512_store_si512(to + 32 * i, v[i]);
}

#endif
