/* The bf16 tile for AMX with AVX512-FP16, shared by inference and training; included by files that the build
 * compiles for these instructions, after #define AMX_GROUPS (groups of 16 points in a tile, even).
 *
 * All layers run as y^T = W x^T: the A tiles are weights (16 outputs x 32 inputs), the B tiles activations of
 * 16 points (16 pairs of inputs x 16 points), so that sums come out as [channel][point] and everything
 * between two products (norms, attention, GELU, encodings) works on 16 points a vector without a shuffle. An
 * activation buffer is [group of points][pair of channels][16 points][2] bf16: 16 pairs are a B tile of
 * contiguous memory. Sums are [group][channel][16 points]. The bank is float16: 32 channels a vector, one FMA
 * for every texel or voxel row of 32. */
#ifndef SHERF_RADIANCE_AMX_H
#define SHERF_RADIANCE_AMX_H

#include "base/amx.h"
#include <math.h>
#include <string.h>

#include "model/sherf/fused/amx_pack.h"

/* gcc's tile loads do not say that they read memory. */
#define ORDER() __asm__ volatile("" ::: "memory")
/* Two rows of 16 points as pairs (even in the low half), rounded half up. */
static inline __m512i pairs(__m512 even, __m512 odd) {
    const __m512i half = _mm512_set1_epi32(0x8000);
    __m512i lo = _mm512_srli_epi32(_mm512_add_epi32(_mm512_castps_si512(even), half), 16);
    __m512i hi = _mm512_add_epi32(_mm512_castps_si512(odd), half);
    return _mm512_mask_blend_epi16(0xAAAAAAAAu, lo, hi);
}

/* ---- elementary functions for bf16 results ---- */
/* 2^x to 8e-5. */
static inline __m512 exp2_16(__m512 x) {
    __m512 n = _mm512_roundscale_ps(x, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
    __m512 r = _mm512_sub_ps(x, n);
    __m512 p = _mm512_fmadd_ps(_mm512_set1_ps(0.05600585f), r, _mm512_set1_ps(0.24263996f));
    p = _mm512_fmadd_ps(p, r, _mm512_set1_ps(0.69310532f));
    p = _mm512_fmadd_ps(p, r, _mm512_set1_ps(0.9999245f));
    return _mm512_scalef_ps(p, n);
}

/* Phi(x) = 1/2 + z P(z^2), z = x clamped to 3.6, where the polynomial is exactly 1; x Phi(x) is right to
 * 6e-4. */
static inline __m512 normal_share(__m512 x) {
    const __m512 end = _mm512_set1_ps(3.6f);
    __m512 z = _mm512_max_ps(_mm512_min_ps(x, end), _mm512_sub_ps(_mm512_setzero_ps(), end));
    __m512 u = _mm512_mul_ps(z, z);
    __m512 p = _mm512_fmadd_ps(_mm512_set1_ps(-4.48422868e-07f), u, _mm512_set1_ps(2.53590834e-05f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(-0.000596707454f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(0.00772175069f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(-0.062254751f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(0.396198f));
    return _mm512_fmadd_ps(p, z, _mm512_set1_ps(0.5f));
}

static inline __m512 gelu_16(__m512 x) {
    return _mm512_mul_ps(normal_share(x), x);
}

/* sin and cos to 1e-7, as in the float32 tile. */
static inline void sincos_16(__m512 x, __m512 *s, __m512 *c) {
    x = _mm512_max_ps(_mm512_min_ps(x, _mm512_set1_ps(1e5f)), _mm512_set1_ps(-1e5f));
    __m512 n = _mm512_roundscale_ps(_mm512_mul_ps(x, _mm512_set1_ps(0.636619772f)),
                                    _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC);
    __m512 r = _mm512_fnmadd_ps(n, _mm512_set1_ps(1.5703125f), x);
    r = _mm512_fnmadd_ps(n, _mm512_set1_ps(4.83751297e-4f), r);
    r = _mm512_fnmadd_ps(n, _mm512_set1_ps(7.54978942e-8f), r);
    __m512 u = _mm512_mul_ps(r, r);
    __m512 ps = _mm512_fmadd_ps(_mm512_set1_ps(-0.0001949564f), u, _mm512_set1_ps(0.0083319787f));
    ps = _mm512_fmadd_ps(ps, u, _mm512_set1_ps(-0.1666665067f));
    ps = _mm512_fmadd_ps(_mm512_mul_ps(r, u), ps, r);
    __m512 pc = _mm512_fmadd_ps(_mm512_set1_ps(2.4438451404e-05f), u, _mm512_set1_ps(-1.3887367514e-03f));
    pc = _mm512_fmadd_ps(pc, u, _mm512_set1_ps(4.1666646866e-02f));
    pc = _mm512_fmadd_ps(pc, u, _mm512_set1_ps(-0.5f));
    pc = _mm512_fmadd_ps(pc, u, _mm512_set1_ps(1.0f));
    __m512i q = _mm512_cvtps_epi32(n);
    const __m512i one = _mm512_set1_epi32(1), two = _mm512_set1_epi32(2);
    __mmask16 odd = _mm512_test_epi32_mask(q, one);
    __m512i s_sign = _mm512_slli_epi32(_mm512_and_epi32(q, two), 30);
    __m512i c_sign = _mm512_slli_epi32(_mm512_and_epi32(_mm512_add_epi32(q, one), two), 30);
    *s = _mm512_xor_ps(_mm512_mask_blend_ps(odd, ps, pc), _mm512_castsi512_ps(s_sign));
    *c = _mm512_xor_ps(_mm512_mask_blend_ps(odd, pc, ps), _mm512_castsi512_ps(c_sign));
}

/* ---- products ---- */
/* An activation buffer: bytes from group to group. */
typedef struct {
    char *at;
    size_t pitch;
} channels;

/* Tiles of sums that wait to be rounded into an activation buffer, with the bias added: this happens between
 * later tile instructions, which need such work there (base/amx.h). */
typedef struct {
    float *sums; /* the newest are stored there one step later */
    const float *bias;
    char *out;
    const char *mask;
} waiting_tile;

typedef struct {
    int count;
    waiting_tile tile[4];
} waiting;

static inline void wait_for(waiting *w, float *sums, const float *bias, char *out, ptrdiff_t mask) {
    w->tile[w->count++] = (waiting_tile){sums, bias, out, mask ? out + mask : NULL};
}

/* Two rows of a tile (r below 8), with ReLU (on bf16 a maximum of signed 16-bit integers), or, in the
 * backward pass, kept where the ReLU's result `mask` is not 0. */
static inline void finish_rows(waiting_tile t, int r, bool masked) {
    const float *sums = t.sums + r * 32, *bias = t.bias + r * 2;
    __m512i y = pairs(_mm512_add_ps(_mm512_load_ps(sums), _mm512_set1_ps(bias[0])),
                      _mm512_add_ps(_mm512_load_ps(sums + GROUP), _mm512_set1_ps(bias[1])));
    if (masked) {
        __m512i x = _mm512_load_si512(t.mask + r * PAIR);
        y = _mm512_maskz_mov_epi16(_mm512_test_epi16_mask(x, x), y);
    } else {
        y = _mm512_max_epi16(y, _mm512_setzero_si512());
    }
    _mm512_store_si512(t.out + r * PAIR, y);
}

static inline void finish(waiting_tile t) {
#pragma GCC unroll 8
    for (int r = 0; r < 8; r++) finish_rows(t, r, t.mask != NULL);
}

static inline void finish_all(waiting *w) {
    for (int i = 0; i < w->count; i++) finish(w->tile[i]);
    w->count = 0;
    ORDER();
}

/* Room for 8 tiles of sums: the half in which something waits, and the other one. */
static inline float *used_half(const waiting *w, float *c) {
    return w->count && w->tile[0].sums >= c + 1024 ? c + 1024 : c;
}
static inline float *free_half(const waiting *w, float *c) {
    return used_half(w, c) == c ? c + 1024 : c;
}

/* The work between two tile instructions of a step: two rows of a waiting tile and a part of the prefetch of
 * the next rows of weights. */
#define BETWEEN(R)                                                                                           \
    do {                                                                                                     \
        ORDER();                                                                                             \
        finish_rows(oldest, R, masked);                                                                      \
        _mm_prefetch(soon + (R)*128, _MM_HINT_T0);                                                           \
        _mm_prefetch(soon + (R)*128 + 64, _MM_HINT_T0);                                                      \
        ORDER();                                                                                             \
    } while (0)
/* The product of a tile of rows (weights in tiles 4 to 7) with one group, into CURRENT. Storing a tile of
 * sums blocks the product unit (16 cycles), unless products that do not need the tile are running. So the
 * previous step's sums (PREVIOUS) are stored here, after the second product, and those of the step before are
 * finished. */
#define STEP(CURRENT, PREVIOUS)                                                                              \
    do {                                                                                                     \
        const char *in = x.at + (size_t)g * x.pitch;                                                         \
        const char *soon = g < blocks ? next + g * 2 * TILE : weight;                                        \
        _tile_zero(CURRENT);                                                                                 \
        _tile_loadd(2, in, 64);                                                                              \
        BETWEEN(0);                                                                                          \
        if (blocks > 1) _tile_loadd(3, in + TILE, 64);                                                       \
        BETWEEN(1);                                                                                          \
        _tile_dpbf16ps(CURRENT, 4, 2);                                                                       \
        BETWEEN(2);                                                                                          \
        if (blocks > 1) _tile_dpbf16ps(CURRENT, 5, 3);                                                       \
        BETWEEN(3);                                                                                          \
        if (step) _tile_stored(PREVIOUS, newest.sums, 64);                                                   \
        if (blocks > 2) _tile_loadd(2, in + 2 * TILE, 64);                                                   \
        BETWEEN(4);                                                                                          \
        if (blocks > 3) _tile_loadd(3, in + 3 * TILE, 64);                                                   \
        BETWEEN(5);                                                                                          \
        if (blocks > 2) _tile_dpbf16ps(CURRENT, 6, 2);                                                       \
        BETWEEN(6);                                                                                          \
        if (blocks > 3) _tile_dpbf16ps(CURRENT, 7, 3);                                                       \
        BETWEEN(7);                                                                                          \
        char *out = y.at + (size_t)g * y.pitch + m * 8 * PAIR;                                               \
        oldest = newest;                                                                                     \
        newest = (waiting_tile){ring + (step & 1) * 256, l->bias + m * 16, out, masked ? out + mask : NULL}; \
        step++;                                                                                              \
        g++;                                                                                                 \
    } while (0)

/* Leaves the last two waiting; if fewer wait, some unused ones are finished into memory that is written
 * again. */
static inline void leave_two(waiting *w, waiting_tile nothing) {
    while (w->count > 2) finish(w->tile[--w->count]);
    while (w->count < 2) w->tile[w->count++] = nothing;
    ORDER();
}

/* y = ReLU(W x + b), or (masked) W x + b where the ReLU's result `mask` bytes after y is not 0; rounded, for
 * all points, of up to 4 column blocks: the weights of 16 rows stay in tiles. The last two tiles are left
 * waiting. Sums alternate between two places: tiles that wait in the first or elsewhere are finished in step
 * 0 and those in the second in step 1, before the next sums arrive there. Inputs, results and two rows of
 * weights fill the L1 cache but for 4 KB. */
static inline __attribute__((always_inline)) void dense_short(const tiles *l, const int blocks, channels x,
                                                              channels y, const bool masked, ptrdiff_t mask,
                                                              float *c, waiting *w) {
    float *ring = used_half(w, c);
    int step = 0;
    leave_two(w, (waiting_tile){ring, l->bias, y.at, masked ? y.at + mask : NULL});
    waiting_tile oldest = w->tile[0], newest = w->tile[1];
    for (int m = 0; m < l->row_tiles; m++) {
        const char *weight = (const char *)l->w + (size_t)(m / 2 * 2 * blocks + m % 2) * TILE;
        const char *next =
            m + 1 < l->row_tiles ? (m & 1 ? weight + (2 * blocks - 1) * TILE : weight + TILE) : weight;
        tile_load(4, weight, 64);
        if (blocks > 1) tile_load(5, weight + 2 * TILE, 64);
        if (blocks > 2) tile_load(6, weight + 4 * TILE, 64);
        if (blocks > 3) tile_load(7, weight + 6 * TILE, 64);
        for (int g = 0; g < AMX_GROUPS;) {
            STEP(0, 1);
            STEP(1, 0);
        }
    }
    _tile_stored(1, newest.sums, 64);
    w->tile[0] = oldest;
    w->tile[1] = newest;
    ORDER();
}

/* A block of columns for 2 row tiles x 2 groups, with BETWEEN between the tile instructions. */
#define LONG_STEP(BETWEEN)                                                                                   \
    do {                                                                                                     \
        _tile_loadd(6, in, 64);                                                                              \
        BETWEEN(0);                                                                                          \
        _tile_loadd(4, weight, 64);                                                                          \
        BETWEEN(1);                                                                                          \
        _tile_dpbf16ps(0, 4, 6);                                                                             \
        BETWEEN(2);                                                                                          \
        _tile_loadd(7, next, 64);                                                                            \
        BETWEEN(3);                                                                                          \
        _tile_dpbf16ps(1, 4, 7);                                                                             \
        BETWEEN(4);                                                                                          \
        _tile_loadd(5, weight + TILE, 64);                                                                   \
        BETWEEN(5);                                                                                          \
        _tile_dpbf16ps(2, 5, 6);                                                                             \
        BETWEEN(6);                                                                                          \
        _tile_dpbf16ps(3, 5, 7);                                                                             \
        BETWEEN(7);                                                                                          \
        weight += 2 * TILE;                                                                                  \
        in += TILE;                                                                                          \
        next += TILE;                                                                                        \
    } while (0)
#define FINISH(R)                                                                                            \
    ORDER();                                                                                                 \
    finish_rows(ready, R, masked);                                                                           \
    ORDER()
#define ROOM(R) TILE_ROOM()

/* The same for more blocks than waiting tiles, by 2 row tiles x 2 groups; the last four tiles are left
 * waiting. */
static inline __attribute__((always_inline)) void
dense_long(const tiles *l, channels x, channels y, const bool masked, ptrdiff_t mask, float *c, waiting *w) {
    for (int m = 0; m < l->row_tiles; m += 2)
        for (int g = 0; g < AMX_GROUPS; g += 2) {
            const char *weight = (const char *)l->w + (size_t)m * (size_t)l->blocks * TILE;
            const char *in = x.at + (size_t)g * x.pitch, *next = in + x.pitch;
            float *sums = free_half(w, c);
            int k = 0;
            _tile_zero(0);
            _tile_zero(1);
            _tile_zero(2);
            _tile_zero(3);
            for (; k < w->count; k++) {
                const waiting_tile ready = w->tile[k];
                LONG_STEP(FINISH);
            }
            for (; k < l->blocks; k++) LONG_STEP(ROOM);
            _tile_stored(0, sums, 64);
            _tile_stored(1, sums + 256, 64);
            _tile_stored(2, sums + 512, 64);
            _tile_stored(3, sums + 768, 64);
            char *out = y.at + (size_t)g * y.pitch + m * 8 * PAIR;
            w->count = 0;
            for (int i = 0; i < 4; i++)
                wait_for(w, sums + i * 256, l->bias + (m + (i >> 1)) * 16,
                         out + (size_t)(i & 1) * y.pitch + (i >> 1) * 8 * PAIR, masked ? mask : 0);
            ORDER();
        }
}

static __attribute__((noinline)) void dense(const tiles *l, channels x, channels y, ptrdiff_t mask, float *c,
                                            waiting *w) {
    if (l->blocks == 4 && !mask)
        dense_short(l, 4, x, y, false, 0, c, w);
    else if (l->blocks <= 4)
        dense_short(l, l->blocks, x, y, mask != 0, mask, c, w);
    else
        dense_long(l, x, y, mask != 0, mask, c, w);
}

/* One row tile for all groups, sums as [group][16][16], without the bias. */
static inline void dense_last(const tiles *l, channels x, float *y) {
    for (int g = 0; g < AMX_GROUPS; g += 2) {
        const char *weight = (const char *)l->w, *in = x.at + (size_t)g * x.pitch, *next = in + x.pitch;
        _tile_zero(0);
        _tile_zero(1);
        for (int k = 0; k < l->blocks; k++) {
            tile_load(4, weight + k * TILE, 64);
            tile_load(5, in + k * TILE, 64);
            tile_product(0, 4, 5);
            tile_load(6, next + k * TILE, 64);
            tile_product(1, 4, 6);
        }
        _tile_stored(0, y + g * 256, 64);
        _tile_stored(1, y + g * 256 + 256, 64);
    }
    ORDER();
}

/* y [32 rows][16] += W x, one group; x: B tiles. */
static inline void add_product(const tiles *l, const char *x, float *y) {
    const char *weight = (const char *)l->w;
    tile_load(0, y, 64);
    tile_load(1, y + 256, 64);
    for (int k = 0; k < l->blocks; k++, weight += 2 * TILE, x += TILE) {
        tile_load(6, x, 64);
        tile_load(4, weight, 64);
        tile_product(0, 4, 6);
        tile_load(5, weight + TILE, 64);
        tile_product(1, 5, 6);
    }
    _tile_stored(0, y, 64);
    _tile_stored(1, y + 256, 64);
}

/* ---- sampling ---- */

/* The same float16 twice in every 32 bits. */
static inline __m512i twice_half(__m512 w) {
    __m512i h = _mm512_cvtepu16_epi32(_mm512_cvtps_ph(w, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
    return _mm512_or_si512(h, _mm512_slli_epi32(h, 16));
}

/* Weights of the two neighbours along an axis (0 outside) and their indices, clamped inside. A NaN position
 * is outside. */
static inline void neighbours(__m512 x, int size, __m512i index[2], __m512 weight[2]) {
    const __m512i last = _mm512_set1_epi32(size - 1), zero = _mm512_setzero_si512();
    x = _mm512_min_ps(_mm512_max_ps(x, _mm512_set1_ps(-2)), _mm512_set1_ps((float)size + 1));
    __m512 low = _mm512_roundscale_ps(x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
    __m512 fraction = _mm512_sub_ps(x, low);
    __m512i i = _mm512_cvtps_epi32(low), j = _mm512_add_epi32(i, _mm512_set1_epi32(1));
    weight[0] = _mm512_maskz_sub_ps(_mm512_cmple_epu32_mask(i, last), _mm512_set1_ps(1), fraction);
    weight[1] = _mm512_maskz_mov_ps(_mm512_cmple_epu32_mask(j, last), fraction);
    index[0] = _mm512_min_epi32(_mm512_max_epi32(i, zero), last);
    index[1] = _mm512_min_epi32(_mm512_max_epi32(j, zero), last);
}

static inline void map_taps(samples *s, int first, int width, int height, int texel_bytes, __m512 x, __m512 y,
                            bool half) {
    __m512i ix[2], iy[2];
    __m512 wx[2], wy[2];
    neighbours(x, width, ix, wx);
    neighbours(y, height, iy, wy);
    for (int k = 0; k < 4; k++) {
        __m512i at = _mm512_add_epi32(_mm512_mullo_epi32(iy[k >> 1], _mm512_set1_epi32(width)), ix[k & 1]);
        __m512 w = _mm512_mul_ps(wx[k & 1], wy[k >> 1]);
        _mm512_store_si512(s->offset[first + k], _mm512_mullo_epi32(at, _mm512_set1_epi32(texel_bytes)));
        _mm512_store_si512(s->weight[first + k], half ? twice_half(w) : _mm512_castps_si512(w));
    }
}

static inline void level_taps(const radiance_level *l, samples *s, int level, const __m512 p[3], bool half) {
    __m512 w[3][2];
    __m512i index[3];
    __mmask16 inside = 0xffff;
    for (int i = 0; i < 3; i++) {
        int size = l->size[2 - i];
        __m512 x = _mm512_mul_ps(p[i], _mm512_set1_ps(l->voxels_per_m[i]));
        x = _mm512_min_ps(_mm512_max_ps(x, _mm512_set1_ps(-2)), _mm512_set1_ps((float)size + 1));
        __m512 low = _mm512_roundscale_ps(x, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC);
        w[i][1] = _mm512_sub_ps(x, low);
        w[i][0] = _mm512_sub_ps(_mm512_set1_ps(1), w[i][1]);
        index[i] = _mm512_add_epi32(_mm512_cvtps_epi32(low), _mm512_set1_epi32(1)); /* of the cell */
        inside &= _mm512_cmple_epu32_mask(index[i], _mm512_set1_epi32(size));
    }
    __m512i at = _mm512_add_epi32(_mm512_mullo_epi32(index[2], _mm512_set1_epi32(l->size[1] + 1)), index[1]);
    at = _mm512_add_epi32(_mm512_mullo_epi32(at, _mm512_set1_epi32(l->size[2] + 1)), index[0]);
    _mm512_store_si512(s->cell[level],
                       _mm512_mask_i32gather_epi32(_mm512_set1_epi32(-1), inside, at, l->cell, 4));
    for (int k = 0; k < 4; k++) {
        __m512 zy = _mm512_mul_ps(w[2][k >> 1], w[1][k & 1]);
        __m512 low = _mm512_mul_ps(zy, w[0][0]), high = _mm512_mul_ps(zy, w[0][1]);
        _mm512_store_si512(s->cell_weight[level][2 * k], half ? twice_half(low) : _mm512_castps_si512(low));
        _mm512_store_si512(s->cell_weight[level][2 * k + 1],
                           half ? twice_half(high) : _mm512_castps_si512(high));
    }
}

/* Plane 0 is read at (x, y), plane 1 at (x, z), plane 2 at (z, y). */
static const int plane_axis[3][2] = {{0, 1}, {0, 2}, {2, 1}};

static inline void find_taps(const radiance_field *n, const point_tile *t, int first, samples *s) {
    __m512 texel[3], at[3];
    for (int i = 0; i < 3; i++) {
        __m512 x = _mm512_load_ps(t->position[i] + first);
        texel[i] = _mm512_fmsub_ps(_mm512_sub_ps(x, _mm512_set1_ps(n->plane_min[i])),
                                   _mm512_set1_ps(n->plane_scale[i]), _mm512_set1_ps(0.5f));
        at[i] = _mm512_sub_ps(x, _mm512_set1_ps(n->volume_min[i]));
    }
    for (int i = 0; i < 3; i++)
        map_taps(s, 4 * i, n->plane[i].width, n->plane[i].height, n->plane[i].stride * 2,
                 texel[plane_axis[i][0]], texel[plane_axis[i][1]], true);
    __m512 u = _mm512_load_ps(t->pixel[0] + first), v = _mm512_load_ps(t->pixel[1] + first);
    map_taps(s, 12, n->map.width, n->map.height, n->map.stride * 2,
             _mm512_mul_ps(u, _mm512_set1_ps(n->map_scale[0])),
             _mm512_mul_ps(v, _mm512_set1_ps(n->map_scale[1])), true);
    map_taps(s, 16, n->image_width, n->image_height, 16, _mm512_mul_ps(u, _mm512_set1_ps(n->image_scale[0])),
             _mm512_mul_ps(v, _mm512_set1_ps(n->image_scale[1])), false);
    for (int i = 0; i < POINT_LEVELS; i++) level_taps(&n->level[i], s, i, at, true);
}

static inline __m512h weight_of(const int32_t *w) {
    return _mm512_castsi512_ph(_mm512_set1_epi32(*w));
}
static inline __m512h row_of(const char *p) {
    return _mm512_loadu_ph(p);
}

/* Point p of the group: the bank's sum of each token into s->value, its colour into s->color. */
static inline void read_point(const radiance_field *n, samples *s, int p) {
    __m512h sum[3], volume[3];
    for (int i = 0; i < 3; i++) {
        const char *base = (const char *)n->plane[i].half;
        sum[i] = _mm512_mul_ph(weight_of(&s->weight[4 * i][p]), row_of(base + s->offset[4 * i][p]));
        for (int k = 1; k < 4; k++)
            sum[i] = _mm512_fmadd_ph(weight_of(&s->weight[4 * i + k][p]),
                                     row_of(base + s->offset[4 * i + k][p]), sum[i]);
        volume[i] = _mm512_setzero_ph();
    }
    for (int k = 0; k < 4; k++) {
        const char *row = (const char *)n->map.half + s->offset[12 + k][p];
        __m512h w = weight_of(&s->weight[12 + k][p]);
        sum[0] = _mm512_fmadd_ph(w, row_of(row), sum[0]);
        if (n->map_tokens > 1) sum[1] = _mm512_fmadd_ph(w, row_of(row + 64), sum[1]);
        if (n->map_tokens > 2) sum[2] = _mm512_fmadd_ph(w, row_of(row + 128), sum[2]);
    }
    for (int l = 0; l < POINT_LEVELS; l++) {
        if (s->cell[l][p] < 0) continue;
        const int32_t *corner = n->level[l].corner[s->cell[l][p]];
        const char *base = (const char *)n->level[l].half;
        for (int k = 0; k < 8; k++) {
            const char *row = base + (size_t)(uint32_t)corner[k] * (3 * WIDTH * 2);
            __m512h w = weight_of(&s->cell_weight[l][k][p]);
            volume[0] = _mm512_fmadd_ph(w, row_of(row), volume[0]);
            volume[1] = _mm512_fmadd_ph(w, row_of(row + 64), volume[1]);
            volume[2] = _mm512_fmadd_ph(w, row_of(row + 128), volume[2]);
        }
    }
    for (int i = 0; i < 3; i++) {
        __m512i h = _mm512_castph_si512(_mm512_add_ph(sum[i], volume[i]));
        _mm512_store_ps(s->value[p] + i * WIDTH, _mm512_cvtph_ps(_mm512_castsi512_si256(h)));
        _mm512_store_ps(s->value[p] + i * WIDTH + 16, _mm512_cvtph_ps(_mm512_extracti64x4_epi64(h, 1)));
    }
    __m128 color = _mm_setzero_ps();
    for (int k = 16; k < 20; k++)
        color = _mm_fmadd_ps(_mm_castsi128_ps(_mm_set1_epi32(s->weight[k][p])),
                             _mm_load_ps((const float *)((const char *)n->image + s->offset[k][p])), color);
    _mm_store_ps(s->color[p], color);
}

/* Four channels of 16 points ([point][stride]) to rows of 16 points: y[c] = x[c] * scale + bias[c]. */
static inline void transpose(const float *x, int stride, __m512 scale, const float *bias, float *y) {
    __m512 r[4];
#pragma GCC unroll 4
    for (int i = 0; i < 4; i++) {
        const float *from = x + i * stride;
        __m512 a = _mm512_castps128_ps512(_mm_load_ps(from));
        a = _mm512_insertf32x4(a, _mm_load_ps(from + 4 * stride), 1);
        a = _mm512_insertf32x4(a, _mm_load_ps(from + 8 * stride), 2);
        r[i] = _mm512_insertf32x4(a, _mm_load_ps(from + 12 * stride), 3);
    }
    __m512 a = _mm512_unpacklo_ps(r[0], r[1]), b = _mm512_unpacklo_ps(r[2], r[3]);
    __m512 c = _mm512_unpackhi_ps(r[0], r[1]), d = _mm512_unpackhi_ps(r[2], r[3]);
    __m512 y0 = _mm512_shuffle_ps(a, b, 0x44), y1 = _mm512_shuffle_ps(a, b, 0xee);
    __m512 y2 = _mm512_shuffle_ps(c, d, 0x44), y3 = _mm512_shuffle_ps(c, d, 0xee);
    _mm512_store_ps(y, _mm512_fmadd_ps(y0, scale, _mm512_set1_ps(bias[0])));
    _mm512_store_ps(y + GROUP, _mm512_fmadd_ps(y1, scale, _mm512_set1_ps(bias[1])));
    _mm512_store_ps(y + 2 * GROUP, _mm512_fmadd_ps(y2, scale, _mm512_set1_ps(bias[2])));
    _mm512_store_ps(y + 3 * GROUP, _mm512_fmadd_ps(y3, scale, _mm512_set1_ps(bias[3])));
}

/* ---- encodings ---- */
/* PE of 16 points into rows of `out` (16 floats each) in the reference's order, by doubled angles: errors
 * double with the frequency, up to 4e-6. Then three rows with the bits of x that bf16 drops. */
static inline void encode(const __m512 x[3], int frequencies, float *out) {
    __m512 s[3], c[3];
    for (int i = 0; i < 3; i++) {
        _mm512_store_ps(out + i * GROUP, x[i]);
        __m512i high = _mm512_add_epi32(_mm512_castps_si512(x[i]), _mm512_set1_epi32(0x8000));
        high = _mm512_and_si512(high, _mm512_set1_epi32((int)0xffff0000u));
        _mm512_store_ps(out + (3 + 6 * frequencies + i) * GROUP,
                        _mm512_sub_ps(x[i], _mm512_castsi512_ps(high)));
        sincos_16(x[i], &s[i], &c[i]);
    }
    for (int k = 0; k < frequencies; k++)
        for (int i = 0; i < 3; i++) {
            _mm512_store_ps(out + (3 + 6 * k + i) * GROUP, s[i]);
            _mm512_store_ps(out + (6 + 6 * k + i) * GROUP, c[i]);
            __m512 twice = _mm512_add_ps(s[i], s[i]), old = s[i];
            s[i] = _mm512_mul_ps(twice, c[i]);
            c[i] = _mm512_fnmadd_ps(twice, old, _mm512_set1_ps(1));
        }
}

/* rows (even) of 16 points to pairs */
static inline void pack_rows(const float *x, int rows, char *out) {
    for (int r = 0; r < rows; r += 2)
        _mm512_store_si512(out + r * 32,
                           pairs(_mm512_load_ps(x + r * GROUP), _mm512_load_ps(x + (r + 1) * GROUP)));
}

/* ---- fusion ---- */
/* One token of one group: layer norm, rounded to a B tile. */
static inline void norm_tile(const float *x, const float *weight, const float *bias, char *out) {
    __m512 a = _mm512_setzero_ps(), b = a, c = a, d = a, aa = a, bb = a, cc = a, dd = a;
    for (int r = 0; r < WIDTH; r += 4, x += 4 * GROUP) {
        __m512 v = _mm512_load_ps(x), w = _mm512_load_ps(x + GROUP);
        a = _mm512_add_ps(a, v);
        aa = _mm512_fmadd_ps(v, v, aa);
        b = _mm512_add_ps(b, w);
        bb = _mm512_fmadd_ps(w, w, bb);
        v = _mm512_load_ps(x + 2 * GROUP);
        w = _mm512_load_ps(x + 3 * GROUP);
        c = _mm512_add_ps(c, v);
        cc = _mm512_fmadd_ps(v, v, cc);
        d = _mm512_add_ps(d, w);
        dd = _mm512_fmadd_ps(w, w, dd);
    }
    x -= WIDTH * GROUP;
    const __m512 part = _mm512_set1_ps(1.0f / WIDTH);
    __m512 mean = _mm512_mul_ps(_mm512_add_ps(_mm512_add_ps(a, b), _mm512_add_ps(c, d)), part);
    __m512 variance = _mm512_mul_ps(_mm512_add_ps(_mm512_add_ps(aa, bb), _mm512_add_ps(cc, dd)), part);
    variance = _mm512_max_ps(_mm512_fnmadd_ps(mean, mean, variance), _mm512_setzero_ps());
    __m512 scale = _mm512_rsqrt14_ps(_mm512_add_ps(variance, _mm512_set1_ps(1e-5f)));
    __m512 shift = _mm512_mul_ps(mean, scale);
    for (int r = 0; r < WIDTH; r += 2) {
        __m512 v = _mm512_fmsub_ps(_mm512_load_ps(x + r * GROUP), scale, shift);
        __m512 w = _mm512_fmsub_ps(_mm512_load_ps(x + (r + 1) * GROUP), scale, shift);
        v = _mm512_fmadd_ps(v, _mm512_set1_ps(weight[r]), _mm512_set1_ps(bias[r]));
        w = _mm512_fmadd_ps(w, _mm512_set1_ps(weight[r + 1]), _mm512_set1_ps(bias[r + 1]));
        _mm512_store_si512(out + r * 32, pairs(v, w));
    }
}
/* q, k, v of one group: sums [token][row][16]; q of token 2 is not needed. */
static inline void qkv_product(const radiance_field *n, const char *normed, float *sums) {
    const tiles *l = &n->amx->qkv;
    int q_tiles = n->attention_width / 16; /* row tiles that contain only q */
    size_t token = (size_t)l->row_tiles * 256;
    ORDER();
    tile_load(4, normed, 64);
    tile_load(5, normed + TILE, 64);
    tile_load(6, normed + 2 * TILE, 64);
    for (int m = 0; m < l->row_tiles; m++) {
        tile_load(7, (const char *)l->w + (size_t)m * TILE, 64);
        float *y = sums + m * 256;
        _tile_zero(0);
        _tile_zero(1);
        tile_product(0, 7, 4);
        tile_product(1, 7, 5);
        if (m >= q_tiles) {
            _tile_zero(2);
            tile_product(2, 7, 6);
            _tile_stored(2, y + 2 * token, 64);
        }
        _tile_stored(0, y, 64);
        _tile_stored(1, y + token, 64);
    }
    ORDER();
}

/* Attention of tokens 0 and 1 to all three, one group; mixed: B tiles of each token. q's weights include the
 * scale and log2 e. chance: [head][2 tokens][3][16], each token's attention weights, or NULL. */
static inline void attention(const radiance_field *n, const float *sums, char *mixed, float *chance) {
    int head = n->s.head_width, all = n->attention_width;
    size_t token = (size_t)n->amx->qkv.row_tiles * 256;
    for (int h = 0; h < n->s.heads; h++) {
        const float *q = sums + h * head * GROUP, *k = q + all * GROUP, *v = k + all * GROUP;
        __m512 e[2][3];
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 3; j++) e[i][j] = _mm512_setzero_ps();
        for (int d = 0; d < head; d++)
            for (int j = 0; j < 3; j++) {
                __m512 key = _mm512_load_ps(k + (size_t)j * token + d * GROUP);
                e[0][j] = _mm512_fmadd_ps(_mm512_load_ps(q + d * GROUP), key, e[0][j]);
                e[1][j] = _mm512_fmadd_ps(_mm512_load_ps(q + token + d * GROUP), key, e[1][j]);
            }
        for (int i = 0; i < 2; i++) {
            __m512 top = _mm512_max_ps(_mm512_max_ps(e[i][0], e[i][1]), e[i][2]);
            for (int j = 0; j < 3; j++) e[i][j] = exp2_16(_mm512_sub_ps(e[i][j], top));
            __m512 part = _mm512_rcp14_ps(_mm512_add_ps(_mm512_add_ps(e[i][0], e[i][1]), e[i][2]));
            for (int j = 0; j < 3; j++) e[i][j] = _mm512_mul_ps(e[i][j], part);
            for (int j = 0; chance && j < 3; j++)
                _mm512_store_ps(chance + ((h * 2 + i) * 3 + j) * GROUP, e[i][j]);
        }
        for (int d = 0; d < head; d += 2) {
            __m512 y[2][2];
            for (int s = 0; s < 2; s++) {
                const float *value = v + (d + s) * GROUP;
                __m512 a = _mm512_load_ps(value), b = _mm512_load_ps(value + token),
                       c = _mm512_load_ps(value + 2 * token);
                for (int i = 0; i < 2; i++)
                    y[i][s] =
                        _mm512_fmadd_ps(e[i][2], c, _mm512_fmadd_ps(e[i][1], b, _mm512_mul_ps(e[i][0], a)));
            }
            for (int i = 0; i < 2; i++)
                _mm512_store_si512(mixed + i * n->amx->mixed_blocks * TILE + (h * head + d) * 32,
                                   pairs(y[i][0], y[i][1]));
        }
    }
}

/* The first layer of the feed-forward part for one token of one group: sums [32][16], without the
 * bias. */
static inline void mlp_product(const tiles *l, const char *normed, float *sums) {
    ORDER();
    _tile_zero(0);
    _tile_zero(1);
    tile_load(6, normed, 64);
    tile_load(4, (const char *)l->w, 64);
    tile_product(0, 4, 6);
    tile_load(5, (const char *)l->w + TILE, 64);
    tile_product(1, 5, 6);
    _tile_stored(0, sums, 64);
    _tile_stored(1, sums + 256, 64);
    ORDER();
}

/* After an encoding: token i, then zeros up to `pairs_all`. */
static inline void pack_token(const float *x, const float *bias, char *out, int pairs_all) {
    for (int r = 0; r < WIDTH; r += 2) {
        __m512 even = _mm512_add_ps(_mm512_load_ps(x + r * GROUP), _mm512_set1_ps(bias[r]));
        __m512 odd = _mm512_add_ps(_mm512_load_ps(x + (r + 1) * GROUP), _mm512_set1_ps(bias[r + 1]));
        _mm512_store_si512(out + r * 32, pairs(even, odd));
    }
    for (int i = WIDTH / 2; i < pairs_all; i++) _mm512_store_si512(out + i * PAIR, _mm512_setzero_si512());
}
/* The values read at the points of one group, as tokens [3 x 32][16] before the transformer. */
static inline void sample_group(const radiance_field *n, const point_tile *t, int first, samples *s,
                                float *row, char *color, float *token) {
    find_taps(n, t, first, s);
    for (int p = 0; p < GROUP; p++) read_point(n, s, p);
    const __m512 scale = _mm512_set1_ps(1.0f / n->bank_scale);
    for (int i = 0; i < 3 * WIDTH; i += 4)
        transpose(s->value[0] + i, 3 * WIDTH, scale, n->token_b + i, token + i * GROUP);
    if (!n->color_width) return;
    const __m512i at = _mm512_setr_epi32(0, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40, 44, 48, 52, 56, 60);
    __m512 rgb[3];
    for (int i = 0; i < 3; i++) rgb[i] = _mm512_i32gather_ps(at, s->color[0] + i, 4);
    encode(rgb, n->s.color_frequencies, row);
    pack_rows(row, round_up(n->color_width, 2), color);
    ORDER();
    for (int i = n->color_token; i < 3; i++) {
        tiles l = n->amx->color;
        l.w += (size_t)(i - n->color_token) * 2 * (size_t)l.blocks * (TILE / 2);
        add_product(&l, color, token + i * WIDTH * GROUP);
    }
    ORDER();
}
/* One group's encoding of x, then its token. */
static inline void pack_input(const float x[3][POINT_TILE], int g, int frequencies, const float *token,
                              const float *bias, float *row, char *out, int blocks) {
    __m512 v[3];
    for (int i = 0; i < 3; i++) v[i] = _mm512_load_ps(x[i] + g * GROUP);
    encode(v, frequencies, row);
    int encoded = 3 + 3 * frequencies; /* pairs */
    pack_rows(row, 2 * encoded, out);
    pack_token(token, bias, out + encoded * PAIR, blocks * 16 - encoded);
}
static inline channels further(channels x, int blocks) {
    return (channels){x.at + (size_t)blocks * TILE, x.pitch};
}

#endif
