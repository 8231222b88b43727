/* AMX tile instructions with space between them. If a core's other hardware thread is busy (usually another
 * guest of the host), a tile instruction directly after another runs at half the rate or less, but at nearly
 * the full rate with seven or more ordinary instructions in between: docs/speed.md has the measurements. On
 * an unshared core they cost nothing, since the product unit is slower. So tiles are loaded and multiplied
 * with these macros, unless other work is placed between them by hand (tile_*_bare). */
#ifndef SHERF_AMX_H
#define SHERF_AMX_H

#include <immintrin.h>
#include <stdint.h>

#define AMX __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,avx512bf16,amx-tile,amx-bf16")))
#define AMX_INLINE AMX static inline __attribute__((always_inline))

#define TILE_ROOM() __asm__ volatile("nop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop\n\tnop")

#define tile_load(tile, at, stride)                                                                          \
    do {                                                                                                     \
        _tile_loadd(tile, at, stride);                                                                       \
        TILE_ROOM();                                                                                         \
    } while (0)

/* sum += a b */
#define tile_product(sum, a, b)                                                                              \
    do {                                                                                                     \
        _tile_dpbf16ps(sum, a, b);                                                                           \
        TILE_ROOM();                                                                                         \
    } while (0)

/* Transposes a 16 x 16 matrix of 32-bit values. */
AMX_INLINE void transpose_16x16(__m512i v[16]) {
    __m512i t[16];
    for (int i = 0; i < 16; i += 2) {
        t[i] = _mm512_unpacklo_epi32(v[i], v[i + 1]);
        t[i + 1] = _mm512_unpackhi_epi32(v[i], v[i + 1]);
    }
    for (int i = 0; i < 16; i += 4) {
        v[i] = _mm512_unpacklo_epi64(t[i], t[i + 2]);
        v[i + 1] = _mm512_unpackhi_epi64(t[i], t[i + 2]);
        v[i + 2] = _mm512_unpacklo_epi64(t[i + 1], t[i + 3]);
        v[i + 3] = _mm512_unpackhi_epi64(t[i + 1], t[i + 3]);
    }
    for (int i = 0; i < 4; i++) {
        t[i] = _mm512_shuffle_i32x4(v[i], v[i + 4], 0x88);
        t[i + 4] = _mm512_shuffle_i32x4(v[i], v[i + 4], 0xdd);
        t[i + 8] = _mm512_shuffle_i32x4(v[i + 8], v[i + 12], 0x88);
        t[i + 12] = _mm512_shuffle_i32x4(v[i + 8], v[i + 12], 0xdd);
    }
    for (int i = 0; i < 4; i++) {
        v[i] = _mm512_shuffle_i32x4(t[i], t[i + 8], 0x88);
        v[i + 8] = _mm512_shuffle_i32x4(t[i], t[i + 8], 0xdd);
        v[i + 4] = _mm512_shuffle_i32x4(t[i + 4], t[i + 12], 0x88);
        v[i + 12] = _mm512_shuffle_i32x4(t[i + 4], t[i + 12], 0xdd);
    }
}

typedef struct {
    uint8_t palette, start_row, reserved[14];
    uint16_t row_bytes[16];
    uint8_t rows[16];
} tile_config;

/* Configures all eight tiles as 16 rows of 64 bytes; _tile_release() ends it. */
AMX_INLINE void tiles_begin(void) {
    tile_config config __attribute__((aligned(64))) = {.palette = 1};
    for (int i = 0; i < 8; i++) {
        config.row_bytes[i] = 64;
        config.rows[i] = 16;
    }
    __asm__ volatile("" : : "r"(&config) : "memory"); /* gcc's intrinsic names 8 of the 64 bytes */
    _tile_loadconfig(&config);
}

#endif
