/* The bf16 tile for AMX with AVX512-FP16 (the build compiles this file for them).
 *
 * All layers run as y^T = W x^T: the A tiles are weights (16 outputs x 32 inputs), the B tiles activations
 * of 16 points (16 pairs of inputs x 16 points), so that sums come out as [channel][point] and everything
 * between two products (norms, attention, GELU, encodings) works on 16 points a vector without a shuffle.
 * An activation buffer is [group of points][pair of channels][16 points][2] bf16: 16 pairs are a B tile of
 * contiguous memory. Sums are [group][channel][16 points].
 * The bank is float16: 32 channels a vector, one FMA for every texel or voxel row of 32. */
#if (defined(__AMX_BF16__) || defined(__AMXBF16__)) && defined(__AVX512FP16__) /* clang 14 says AMXBF16 */
#include <immintrin.h>
#include <math.h>
#include <string.h>

#include "render/pointnet_inside.h"

enum {
    WIDTH = 32, /* of a token: the only one supported here */
    GROUP = 16, /* points of a vector */
    GROUPS = POINT_TILE / GROUP,
    PAIR = 64,  /* bytes of a pair of channels */
    TILE = 1024 /* bytes of a tile */
};

/* gcc's tile loads do not say that they read memory. */
#define ORDER() __asm__ volatile("" ::: "memory")

/* Weights as tiles: [pair of row tiles][column block][2][16 rows][32 columns]; with an odd number of row
 * tiles the last comes alone. bias: a tile a row tile, every row 16 times the same value. */
typedef struct {
    int row_tiles, blocks;
    uint16_t *w;
    float *bias;
} tiles;

struct point_amx {
    tiles color, qkv, attention_out, mlp0, mlp1, pts[POINT_DECODER_MAX], views, alpha, rgb;
    int x_blocks, h_blocks,
        v_blocks;     /* of 32 channels: [PE(position), token 0], h, [PE(direction), token 1] */
    int mixed_blocks; /* attention's result and two ones for the bias */
    float *mlp1_b;
    /* where the parts of the scratch are, bytes */
    size_t x_pitch, v_pitch, h_pitch; /* of the activation buffers */
    size_t token, x, v, a, b, c, sample, row, color_tiles, normed, mixed, sums;
};

/* ---- bf16 ---- */
static uint16_t to_bf16(float x) {
    uint32_t u;
    memcpy(&u, &x, 4);
    return (uint16_t)((u + 0x7fffu + (u >> 16 & 1u)) >> 16);
}

static float from_bf16(uint16_t x) {
    uint32_t u = (uint32_t)x << 16;
    float y;
    memcpy(&y, &u, 4);
    return y;
}

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

/* x Phi(x) to 6e-4: Phi(x) = 1/2 + z P(z^2) with z = x clamped to 3.6, where the polynomial is exactly 1. */
static inline __m512 gelu_16(__m512 x) {
    const __m512 end = _mm512_set1_ps(3.6f);
    __m512 z = _mm512_max_ps(_mm512_min_ps(x, end), _mm512_sub_ps(_mm512_setzero_ps(), end));
    __m512 u = _mm512_mul_ps(z, z);
    __m512 p = _mm512_fmadd_ps(_mm512_set1_ps(-4.48422868e-07f), u, _mm512_set1_ps(2.53590834e-05f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(-0.000596707454f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(0.00772175069f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(-0.062254751f));
    p = _mm512_fmadd_ps(p, u, _mm512_set1_ps(0.396198f));
    p = _mm512_fmadd_ps(p, z, _mm512_set1_ps(0.5f));
    return _mm512_mul_ps(p, x);
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

/* Tiles of sums that wait to be rounded into an activation buffer: it is done beside later products. */
typedef struct {
    int count;
    struct {
        const float *sums;
        char *out;
    } tile[4];
} waiting;

static inline void wait_for(waiting *w, const float *sums, char *out) {
    w->tile[w->count].sums = sums;
    w->tile[w->count++].out = out;
}

/* Half a tile, with ReLU (on bf16 a maximum of signed 16-bit integers). */
static inline void finish_half(const float *sums, char *out) {
#pragma GCC unroll 4
    for (int r = 0; r < 4; r++) {
        __m512i y = pairs(_mm512_load_ps(sums + r * 32), _mm512_load_ps(sums + r * 32 + GROUP));
        _mm512_store_si512(out + r * PAIR, _mm512_max_epi16(y, _mm512_setzero_si512()));
    }
}

static inline void finish(const waiting *w, int i) {
    finish_half(w->tile[i].sums, w->tile[i].out);
    finish_half(w->tile[i].sums + 128, w->tile[i].out + 4 * PAIR);
}

static inline void finish_all(waiting *w) {
    for (int i = 0; i < w->count; i++) finish(w, i);
    w->count = 0;
    ORDER();
}

/* Room for 8 tiles of sums: the half that nothing waits in. */
static inline float *free_half(const waiting *w, float *c) {
    return w->count && w->tile[0].sums < c + 1024 ? c + 1024 : c;
}

#define PREFETCH                                                                                             \
    if (soon && g < blocks)                                                                                  \
        for (int i = 0; i < TILE; i += 64) _mm_prefetch(soon + g * 2 * TILE + i, _MM_HINT_T0)
/* The product of a tile of rows (weights in tiles 4 to 7) with one group, into CURRENT. Storing a tile of
 * sums keeps the product unit from starting anything (16 cycles), unless products that do not need the tile
 * are under way: so the step before's sums (PREVIOUS) are stored here, after the second product. */
#define STEP(CURRENT, PREVIOUS)                                                                              \
    do {                                                                                                     \
        const char *in = x.at + (size_t)g * x.pitch;                                                         \
        _tile_loadd(CURRENT, bias, 64);                                                                      \
        _tile_loadd(2, in, 64);                                                                              \
        _tile_dpbf16ps(CURRENT, 4, 2);                                                                       \
        if (blocks > 1) {                                                                                    \
            _tile_loadd(3, in + TILE, 64);                                                                   \
            _tile_dpbf16ps(CURRENT, 5, 3);                                                                   \
        }                                                                                                    \
        int before = w->count;                                                                               \
        if (previous) {                                                                                      \
            _tile_stored(PREVIOUS, sums, 64);                                                                \
            wait_for(w, sums, previous);                                                                     \
            step++;                                                                                          \
            sums = ring + (step & 3) * 256;                                                                  \
        }                                                                                                    \
        if (blocks > 2) {                                                                                    \
            _tile_loadd(2, in + 2 * TILE, 64);                                                               \
            _tile_dpbf16ps(CURRENT, 6, 2);                                                                   \
        }                                                                                                    \
        if (blocks > 3) {                                                                                    \
            _tile_loadd(3, in + 3 * TILE, 64);                                                               \
            _tile_dpbf16ps(CURRENT, 7, 3);                                                                   \
        }                                                                                                    \
        int done = before > 2 ? 2 : before;                                                                  \
        for (int i = 0; i < done; i++) finish(w, i);                                                         \
        for (int i = done; i < w->count; i++) w->tile[i - done] = w->tile[i];                                \
        w->count -= done;                                                                                    \
        PREFETCH;                                                                                            \
        previous = y.at + (size_t)g * y.pitch + m * 8 * PAIR;                                                \
        g++;                                                                                                 \
    } while (0)

/* y = ReLU(W x + b), rounded, for all points, of up to 4 column blocks: the weights of 16 rows stay in tiles.
 * The last two tiles are left waiting. */
static void dense_short(const tiles *l, channels x, channels y, float *c, waiting *w) {
    float *ring = free_half(w, c), *sums = ring;
    char *previous = NULL;
    int blocks = l->blocks, step = 0;
    for (int m = 0; m < l->row_tiles; m++) {
        const char *weight = (const char *)l->w + (size_t)(m / 2 * 2 * blocks + m % 2) * TILE;
        const float *bias = l->bias + m * 256;
        const char *soon =
            m + 1 < l->row_tiles ? (m & 1 ? weight + (2 * blocks - 1) * TILE : weight + TILE) : NULL;
        _tile_loadd(4, weight, 64);
        if (blocks > 1) _tile_loadd(5, weight + 2 * TILE, 64);
        if (blocks > 2) _tile_loadd(6, weight + 4 * TILE, 64);
        if (blocks > 3) _tile_loadd(7, weight + 6 * TILE, 64);
        for (int g = 0; g < GROUPS;) {
            STEP(0, 1);
            STEP(1, 0);
        }
    }
    _tile_stored(1, sums, 64);
    wait_for(w, sums, previous);
    ORDER();
}

/* The same for any number of blocks, by 2 row tiles x 2 groups; the last four tiles are left waiting. */
static void dense_long(const tiles *l, channels x, channels y, float *c, waiting *w) {
    int blocks = l->blocks;
    for (int m = 0; m < l->row_tiles; m += 2)
        for (int g = 0; g < GROUPS; g += 2) {
            const char *weight = (const char *)l->w + (size_t)m * (size_t)blocks * TILE;
            const char *in = x.at + (size_t)g * x.pitch, *next = in + x.pitch;
            const float *bias = l->bias + m * 256;
            float *sums = free_half(w, c);
            _tile_loadd(0, bias, 64);
            _tile_loadd(1, bias, 64);
            _tile_loadd(2, bias + 256, 64);
            _tile_loadd(3, bias + 256, 64);
            int done = 0;
            for (int k = 0; k < blocks; k++, weight += 2 * TILE, in += TILE, next += TILE) {
                _tile_loadd(6, in, 64);
                _tile_loadd(4, weight, 64);
                _tile_dpbf16ps(0, 4, 6);
                _tile_loadd(7, next, 64);
                _tile_dpbf16ps(1, 4, 7);
                _tile_loadd(5, weight + TILE, 64);
                _tile_dpbf16ps(2, 5, 6);
                _tile_dpbf16ps(3, 5, 7);
                if (done < w->count) finish(w, done++);
            }
            while (done < w->count) finish(w, done++);
            ORDER();
            _tile_stored(0, sums, 64);
            _tile_stored(1, sums + 256, 64);
            _tile_stored(2, sums + 512, 64);
            _tile_stored(3, sums + 768, 64);
            char *out = y.at + (size_t)g * y.pitch + m * 8 * PAIR;
            w->count = 0;
            for (int i = 0; i < 4; i++)
                wait_for(w, sums + i * 256, out + (size_t)(i & 1) * y.pitch + (i >> 1) * 8 * PAIR);
            ORDER();
        }
}

static void dense(const tiles *l, channels x, channels y, float *c, waiting *w) {
    if (l->blocks <= 4)
        dense_short(l, x, y, c, w);
    else
        dense_long(l, x, y, c, w);
}

/* One row tile for all groups, sums as [group][16][16]. */
static void dense_last(const tiles *l, channels x, float *y) {
    for (int g = 0; g < GROUPS; g += 2) {
        const char *weight = (const char *)l->w, *in = x.at + (size_t)g * x.pitch, *next = in + x.pitch;
        _tile_loadd(0, l->bias, 64);
        _tile_loadd(1, l->bias, 64);
        for (int k = 0; k < l->blocks; k++) {
            _tile_loadd(4, weight + k * TILE, 64);
            _tile_loadd(5, in + k * TILE, 64);
            _tile_dpbf16ps(0, 4, 5);
            _tile_loadd(6, next + k * TILE, 64);
            _tile_dpbf16ps(1, 4, 6);
        }
        _tile_stored(0, y + g * 256, 64);
        _tile_stored(1, y + g * 256 + 256, 64);
    }
    ORDER();
}

/* y [32 rows][16] += W x, one group; x: B tiles. */
static inline void add_product(const tiles *l, const char *x, float *y) {
    const char *weight = (const char *)l->w;
    _tile_loadd(0, y, 64);
    _tile_loadd(1, y + 256, 64);
    for (int k = 0; k < l->blocks; k++, weight += 2 * TILE, x += TILE) {
        _tile_loadd(6, x, 64);
        _tile_loadd(4, weight, 64);
        _tile_dpbf16ps(0, 4, 6);
        _tile_loadd(5, weight + TILE, 64);
        _tile_dpbf16ps(1, 5, 6);
    }
    _tile_stored(0, y, 64);
    _tile_stored(1, y + 256, 64);
}

/* ---- sampling ---- */
enum { TAPS = 4 * 4 + 4 }; /* 3 planes, the map, the image */
typedef struct {
    _Alignas(64) int32_t offset[TAPS][GROUP]; /* bytes */
    int32_t weight[TAPS][GROUP];              /* float16 twice; the image's are float */
    int32_t cell[POINT_LEVELS][GROUP];
    int32_t cell_weight[POINT_LEVELS][8][GROUP];
    float value[GROUP][3 * WIDTH];
    float color[GROUP][4];
} samples;

/* The same float16 twice in every 32 bits. */
static inline __m512i twice_half(__m512 w) {
    __m512i h = _mm512_cvtepu16_epi32(_mm512_cvtps_ph(w, _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC));
    return _mm512_or_si512(h, _mm512_slli_epi32(h, 16));
}

/* Weights of the two neighbours along an axis (0 outside) and their indices, clamped inside. A position
 * that is not a number is outside. */
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

static inline void level_taps(const point_level *l, samples *s, int level, const __m512 p[3]) {
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
        _mm512_store_si512(s->cell_weight[level][2 * k], twice_half(_mm512_mul_ps(zy, w[0][0])));
        _mm512_store_si512(s->cell_weight[level][2 * k + 1], twice_half(_mm512_mul_ps(zy, w[0][1])));
    }
}

static void find_taps(const point_network *n, const point_tile *t, int first, samples *s) {
    static const int axis[3][2] = {{0, 1}, {0, 2}, {2, 1}};
    __m512 texel[3], at[3];
    for (int i = 0; i < 3; i++) {
        __m512 x = _mm512_load_ps(t->position[i] + first);
        texel[i] = _mm512_fmsub_ps(_mm512_sub_ps(x, _mm512_set1_ps(n->plane_min[i])),
                                   _mm512_set1_ps(n->plane_scale[i]), _mm512_set1_ps(0.5f));
        at[i] = _mm512_sub_ps(x, _mm512_set1_ps(n->volume_min[i]));
    }
    for (int i = 0; i < 3; i++)
        map_taps(s, 4 * i, n->plane[i].width, n->plane[i].height, n->plane[i].stride * 2, texel[axis[i][0]],
                 texel[axis[i][1]], true);
    __m512 u = _mm512_load_ps(t->pixel[0] + first), v = _mm512_load_ps(t->pixel[1] + first);
    map_taps(s, 12, n->map.width, n->map.height, n->map.stride * 2,
             _mm512_mul_ps(u, _mm512_set1_ps(n->map_scale[0])),
             _mm512_mul_ps(v, _mm512_set1_ps(n->map_scale[1])), true);
    map_taps(s, 16, n->image_width, n->image_height, 16, _mm512_mul_ps(u, _mm512_set1_ps(n->image_scale[0])),
             _mm512_mul_ps(v, _mm512_set1_ps(n->image_scale[1])), false);
    for (int i = 0; i < POINT_LEVELS; i++) level_taps(&n->level[i], s, i, at);
}

static inline __m512h weight_of(const int32_t *w) {
    return _mm512_castsi512_ph(_mm512_set1_epi32(*w));
}
static inline __m512h row_of(const char *p) {
    return _mm512_loadu_ph(p);
}

/* Point p of the group: the bank's sum of each token into s->value, its colour into s->color. */
static inline void read_point(const point_network *n, samples *s, int p) {
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
 * double with the frequency, up to 4e-6. Then three rows with what bf16 drops of x. */
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
static inline void qkv_product(const point_network *n, const char *normed, float *sums) {
    const tiles *l = &n->amx->qkv;
    int q_tiles = n->attention_width / 16; /* row tiles with nothing but q */
    size_t token = (size_t)l->row_tiles * 256;
    ORDER();
    _tile_loadd(4, normed, 64);
    _tile_loadd(5, normed + TILE, 64);
    _tile_loadd(6, normed + 2 * TILE, 64);
    for (int m = 0; m < l->row_tiles; m++) {
        _tile_loadd(7, (const char *)l->w + (size_t)m * TILE, 64);
        float *y = sums + m * 256;
        _tile_zero(0);
        _tile_zero(1);
        _tile_dpbf16ps(0, 7, 4);
        _tile_dpbf16ps(1, 7, 5);
        if (m >= q_tiles) {
            _tile_zero(2);
            _tile_dpbf16ps(2, 7, 6);
            _tile_stored(2, y + 2 * token, 64);
        }
        _tile_stored(0, y, 64);
        _tile_stored(1, y + token, 64);
    }
    ORDER();
}

/* Attention of tokens 0 and 1 to all three, one group; mixed: B tiles of each token. The scale and log2 e
 * are in q's weights. */
static inline void attention(const point_network *n, const float *sums, char *mixed) {
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

/* The first layer of the feed-forward part for one token of one group: sums [32][16]. */
static inline void mlp_product(const tiles *l, const char *normed, float *sums) {
    ORDER();
    _tile_loadd(0, l->bias, 64);
    _tile_loadd(1, l->bias + 256, 64);
    _tile_loadd(6, normed, 64);
    _tile_loadd(4, (const char *)l->w, 64);
    _tile_dpbf16ps(0, 4, 6);
    _tile_loadd(5, (const char *)l->w + TILE, 64);
    _tile_dpbf16ps(1, 5, 6);
    _tile_stored(0, sums, 64);
    _tile_stored(1, sums + 256, 64);
    ORDER();
}

/* Scratch of the fusion: B tiles of the norms and of attention, sums. */
typedef struct {
    char *normed, *mixed;
    float *sums;
} fusion_space;

/* token [group][3 x 32][16]: tokens 0 and 1 in place (token 2 serves as key and value only, since the decoder
 * never reads its result); the last bias, mlp1's, is left to the reader. */
static void transformer(const point_network *n, float *token, fusion_space f) {
    const point_amx *a = n->amx;
    enum { ONE = WIDTH * GROUP, ALL = 3 * ONE };
    size_t mixed = (size_t)a->mixed_blocks * TILE;
    for (int k = 0; k < 3 * GROUPS; k++)
        norm_tile(token + k * ONE, n->norm0_w, n->norm0_b, f.normed + k * TILE);
    for (int g = 0; g < GROUPS; g++) {
        qkv_product(n, f.normed + g * 3 * TILE, f.sums);
        attention(n, f.sums, f.mixed + (size_t)g * 2 * mixed);
    }
    ORDER();
    for (int k = 0; k < 2 * GROUPS; k++)
        add_product(&a->attention_out, f.mixed + (size_t)k * mixed, token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
    for (int k = 0; k < 2 * GROUPS; k++)
        norm_tile(token + (k >> 1) * ALL + (k & 1) * ONE, n->norm1_w, n->norm1_b, f.normed + k * TILE);
    for (int k = 0; k < 2 * GROUPS; k++) mlp_product(&a->mlp0, f.normed + k * TILE, f.sums + k * 512);
    for (int k = 0; k < 2 * GROUPS; k++)
        for (int r = 0; r < WIDTH; r += 2) {
            const float *x = f.sums + k * 512 + r * GROUP;
            _mm512_store_si512(f.normed + k * TILE + r * 32,
                               pairs(gelu_16(_mm512_load_ps(x)), gelu_16(_mm512_load_ps(x + GROUP))));
        }
    ORDER();
    for (int k = 0; k < 2 * GROUPS; k++)
        add_product(&a->mlp1, f.normed + k * TILE, token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
}

/* Behind an encoding: token i, then zeros up to `pairs_all`. */
static inline void pack_token(const float *x, const float *bias, char *out, int pairs_all) {
    for (int r = 0; r < WIDTH; r += 2) {
        __m512 even = _mm512_add_ps(_mm512_load_ps(x + r * GROUP), _mm512_set1_ps(bias[r]));
        __m512 odd = _mm512_add_ps(_mm512_load_ps(x + (r + 1) * GROUP), _mm512_set1_ps(bias[r + 1]));
        _mm512_store_si512(out + r * 32, pairs(even, odd));
    }
    for (int i = WIDTH / 2; i < pairs_all; i++) _mm512_store_si512(out + i * PAIR, _mm512_setzero_si512());
}

/* ---- the tile ---- */
static void load_config(void) {
    struct {
        uint8_t palette, start, reserved[14];
        uint16_t bytes[16];
        uint8_t rows[16];
    } config __attribute__((aligned(64))) = {.palette = 1};
    for (int i = 0; i < 8; i++) {
        config.bytes[i] = 64;
        config.rows[i] = 16;
    }
    __asm__ volatile("" : : "r"(&config) : "memory"); /* gcc's intrinsic names 8 of the 64 bytes */
    _tile_loadconfig(&config);
}

/* Everything read at the points of one group, as tokens [3 x 32][16] before the transformer. */
static void sample_group(const point_network *n, const point_tile *t, int first, samples *s, float *row,
                         char *color, float *token) {
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
static void pack_input(const float x[3][POINT_TILE], int g, int frequencies, const float *token,
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

/* x: [PE(position), token 0], h; v: h, [PE(direction), token 1] */
static void decoder(const point_network *n, channels x, channels v, channels a, channels b, float *c,
                    point_tile *t) {
    const point_amx *p = n->amx;
    channels in = x;
    waiting w = {0};
    for (int i = 0; i < n->s.decoder_depth; i++) {
        bool last = i == n->s.decoder_depth - 1, skip = i == n->s.decoder_skip && !last;
        channels out = last ? v : skip ? further(x, p->x_blocks) : in.at == a.at ? b : a;
        dense(&p->pts[i], in, out, c, &w);
        in = skip ? x : out;
    }
    dense(&p->views, v, a, c, &w);
    finish_all(&w);
    float *y = c + GROUPS * 256;
    dense_last(&p->alpha, v, c);
    dense_last(&p->rgb, a, y);
    for (int g = 0; g < GROUPS; g++, c += 256, y += 256) {
        _mm512_store_ps(t->out[3] + g * GROUP, _mm512_add_ps(_mm512_load_ps(c), _mm512_load_ps(c + GROUP)));
        for (int k = 0; k < 3; k++) {
            __m512 e = _mm512_add_ps(_mm512_load_ps(y + k * GROUP), _mm512_load_ps(y + (k + 3) * GROUP));
            e = exp2_16(_mm512_mul_ps(e, _mm512_set1_ps(-1.44269504f)));
            e = _mm512_div_ps(_mm512_set1_ps(1.002f), _mm512_add_ps(e, _mm512_set1_ps(1)));
            _mm512_store_ps(t->out[k] + g * GROUP, _mm512_sub_ps(e, _mm512_set1_ps(0.001f)));
        }
    }
}

static void tile_amx(const point_network *n, point_tile *t, void *scratch) {
    const point_amx *p = n->amx;
    char *base = scratch;
    channels x = {base + p->x, p->x_pitch}, v = {base + p->v, p->v_pitch}, a = {base + p->a, p->h_pitch},
             b = {base + p->b, p->h_pitch};
    float *token = (float *)(base + p->token), *row = (float *)(base + p->row);
    fusion_space f = {base + p->normed, base + p->mixed, (float *)(base + p->sums)};
    load_config();
    memset(base + p->color_tiles, 0, (size_t)p->color.blocks * TILE);
    for (int g = 0; g < GROUPS; g++)
        sample_group(n, t, g * GROUP, (samples *)(base + p->sample), row, base + p->color_tiles,
                     token + g * 3 * WIDTH * GROUP);
    /* behind attention's result: two ones for its bias, then zeros */
    const __m512i ones = _mm512_set1_epi32(0x3f803f80);
    for (int k = 0; k < 2 * GROUPS; k++)
        for (int r = n->attention_width / 2; r < p->mixed_blocks * 16; r++)
            _mm512_store_si512(f.mixed + k * p->mixed_blocks * TILE + r * PAIR,
                               r == n->attention_width / 2 ? ones : _mm512_setzero_si512());
    transformer(n, token, f);
    for (int g = 0; g < GROUPS; g++) {
        const float *first = token + g * 3 * WIDTH * GROUP;
        pack_input((const float(*)[POINT_TILE])t->position, g, n->s.position_frequencies, first, p->mlp1_b,
                   row, x.at + (size_t)g * x.pitch, p->x_blocks);
        pack_input((const float(*)[POINT_TILE])t->direction, g, n->s.direction_frequencies,
                   first + WIDTH * GROUP, p->mlp1_b, row,
                   v.at + (size_t)g * v.pitch + (size_t)p->h_blocks * TILE, p->v_blocks);
    }
    ORDER();
    decoder(n, x, v, a, b, (float *)(base + p->c), t);
    _tile_release();
}

/* ---- packing ---- */
/* slot[i]: the column of m that input i of the packed layer has, -1: none. */
static sherf_status pack(context *c, const point_matrix *m, int row_tiles, int blocks, const int *slot,
                         tiles *out) {
    *out = (tiles){.row_tiles = row_tiles, .blocks = blocks};
    out->w = mem_zero(c, (size_t)row_tiles * (size_t)blocks, TILE);
    out->bias = mem_zero(c, (size_t)row_tiles * 256, sizeof(float));
    if (!out->w || !out->bias) return SHERF_NO_MEMORY;
    for (int r = 0; r < m->rows; r++) {
        for (int i = 0; i < 16; i++) out->bias[r * 16 + i] = m->b[r];
        int tile = r / 16, pair = tile / 2;
        int width = 2 * pair + 1 < row_tiles ? 2 : 1; /* row tiles side by side */
        for (int k = 0; k < blocks * 32; k++) {
            if (slot[k] < 0) continue;
            size_t at = ((size_t)pair * 2 * (size_t)blocks + (size_t)(k / 32 * width + tile % 2)) * 512 +
                        (size_t)(r % 16 * 32 + k % 32);
            out->w[at] = to_bf16(m->w[(size_t)r * (size_t)m->columns + (size_t)slot[k]]);
        }
    }
    return SHERF_OK;
}

enum { SLOTS = 8192 };

static void no_slots(int *slot) {
    for (int i = 0; i < SLOTS; i++) slot[i] = -1;
}

/* slots [at, at + count) read columns from `column` on */
static void add_slots(int *slot, int at, int column, int count) {
    for (int i = 0; i < count; i++) slot[at + i] = column + i;
}

/* [PE of width, the three low parts, token] */
static void add_encoded(int *slot, int at, int column, int width) {
    add_slots(slot, at, column, width);
    add_slots(slot, at + width, column, 3);
    add_slots(slot, at + width + 3, column + width, WIDTH);
}

/* Twice the rows: what bf16 keeps of the weights, then what it drops. */
static sherf_status pack_precise(context *c, const point_matrix *m, int blocks, const int *slot, tiles *out) {
    point_matrix two = {.rows = 2 * m->rows, .columns = m->columns};
    size_t count = (size_t)m->rows * (size_t)m->columns;
    two.w = mem_alloc(c, 2 * count, sizeof(float));
    two.b = mem_zero(c, (size_t)two.rows, sizeof(float));
    sherf_status status = two.w && two.b ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        for (size_t i = 0; i < count; i++) {
            two.w[i] = from_bf16(to_bf16(m->w[i]));
            two.w[count + i] = m->w[i] - two.w[i];
        }
        memcpy(two.b, m->b, (size_t)m->rows * sizeof(float));
        status = pack(c, &two, 1, blocks, slot, out);
    }
    mem_free(two.w);
    mem_free(two.b);
    return status;
}

/* attention_out with its bias as two more columns (its high and low part), which meet ones. */
static sherf_status pack_attention_out(context *c, const point_matrix *m, int blocks, int *slot, tiles *out) {
    point_matrix wide = {.rows = m->rows, .columns = m->columns + 2};
    wide.w = mem_alloc(c, (size_t)wide.rows * (size_t)wide.columns, sizeof(float));
    wide.b = mem_zero(c, (size_t)wide.rows, sizeof(float));
    sherf_status status = wide.w && wide.b ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        for (int r = 0; r < m->rows; r++) {
            float *w = wide.w + (size_t)r * (size_t)wide.columns;
            memcpy(w, m->w + (size_t)r * (size_t)m->columns, (size_t)m->columns * sizeof(float));
            w[m->columns] = from_bf16(to_bf16(m->b[r]));
            w[m->columns + 1] = m->b[r] - w[m->columns];
        }
        no_slots(slot);
        add_slots(slot, 0, 0, wide.columns);
        status = pack(c, &wide, 2, blocks, slot, out);
    }
    mem_free(wide.w);
    mem_free(wide.b);
    return status;
}

static sherf_status pack_fusion(context *c, const point_network *n, point_matrices *m, int *slot,
                                point_amx *a) {
    sherf_status status = SHERF_OK;
    no_slots(slot);
    add_slots(slot, 0, 0, n->color_width);
    if (n->color_width)
        status = pack(c, &m->color, m->color.rows / 16, (n->color_width + 31) / 32, slot, &a->color);
    /* attention's scale and log2 e go into q */
    float scale = 1.44269504f / sqrtf((float)n->s.head_width);
    for (int i = 0; i < n->attention_width * WIDTH; i++) m->qkv.w[i] *= scale;
    no_slots(slot);
    add_slots(slot, 0, 0, WIDTH);
    if (!status) status = pack(c, &m->qkv, (3 * n->attention_width + 15) / 16, 1, slot, &a->qkv);
    if (!status) status = pack(c, &m->mlp0, 2, 1, slot, &a->mlp0);
    if (!status) status = pack(c, &m->mlp1, 2, 1, slot, &a->mlp1);
    if (!status) status = pack_attention_out(c, &m->attention_out, a->mixed_blocks, slot, &a->attention_out);
    a->mlp1_b = status ? NULL : mem_alloc(c, WIDTH, sizeof(float));
    if (a->mlp1_b) memcpy(a->mlp1_b, m->mlp1.b, WIDTH * sizeof(float));
    return status ? status : a->mlp1_b ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status pack_decoder(context *c, const point_network *n, const point_matrices *m, int *slot,
                                 point_amx *a) {
    int h = n->s.decoder_width, x = n->position_width + WIDTH, h_tiles = 2 * a->h_blocks;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < n->s.decoder_depth && !status; i++) {
        bool first = i == 0, wide = i == n->s.decoder_skip + 1 && !first;
        no_slots(slot);
        if (first || wide) add_encoded(slot, 0, 0, n->position_width);
        if (!first) add_slots(slot, wide ? a->x_blocks * 32 : 0, wide ? x : 0, h);
        int blocks = first ? a->x_blocks : a->h_blocks + (wide ? a->x_blocks : 0);
        status = pack(c, &m->pts[i], h_tiles, blocks, slot, &a->pts[i]);
    }
    no_slots(slot);
    add_slots(slot, 0, 0, h);
    if (!status) status = pack_precise(c, &m->alpha, a->h_blocks, slot, &a->alpha);
    add_encoded(slot, a->h_blocks * 32, h, n->direction_width);
    int view_tiles = round_up(n->s.view_width, 32) / 16;
    if (!status) status = pack(c, &m->views, view_tiles, a->h_blocks + a->v_blocks, slot, &a->views);
    no_slots(slot);
    add_slots(slot, 0, 0, n->s.view_width);
    if (!status) status = pack_precise(c, &m->rgb, view_tiles / 2, slot, &a->rgb);
    return status;
}

static void lay_out(point_network *n, point_amx *a) {
    size_t at = 0,
           wide = (size_t)(a->h_blocks > a->views.row_tiles / 2 ? a->h_blocks : a->views.row_tiles / 2);
    /* a line more, so that groups do not fall on the same sets of the cache */
    a->x_pitch = (size_t)(a->x_blocks + a->h_blocks) * TILE + 64;
    a->v_pitch = (size_t)(a->h_blocks + a->v_blocks) * TILE + 64;
    a->h_pitch = wide * TILE + 64;
    size_t sums = (size_t)a->qkv.row_tiles * 3 * TILE;
    if (sums < 4 * GROUPS * TILE) sums = 4 * GROUPS * TILE;
    struct {
        size_t *place, bytes;
    } parts[] = {
        {&a->token, 3 * WIDTH * POINT_TILE * sizeof(float)},
        {&a->x, GROUPS * a->x_pitch},
        {&a->v, GROUPS * a->v_pitch},
        {&a->a, GROUPS * a->h_pitch},
        {&a->b, GROUPS * a->h_pitch},
        {&a->c, 2 * 1024 * sizeof(float)},
        {&a->sample, sizeof(samples)},
        {&a->row, (size_t)(6 + 6 * 16) * GROUP * sizeof(float)},
        {&a->color_tiles, (size_t)(a->color.blocks + 1) * TILE},
        {&a->normed, 3 * GROUPS * TILE},
        {&a->mixed, 2 * GROUPS * (size_t)a->mixed_blocks * TILE},
        {&a->sums, sums},
    };
    for (size_t i = 0; i < COUNT_OF(parts); i++) {
        *parts[i].place = at;
        at += (parts[i].bytes + 63) / 64 * 64;
    }
    n->scratch_bytes = at;
}

bool point_amx_fits(const point_sizes *s) {
    return s->token_width == WIDTH && s->head_width % 2 == 0 && s->heads * s->head_width % 16 == 0 &&
           s->heads * s->head_width <= 512 && s->decoder_width <= 1024;
}

sherf_status point_amx_create(context *c, point_network *n, point_matrices *m) {
    point_amx *a = n->amx = mem_zero(c, 1, sizeof *a);
    int *slot = a ? mem_alloc(c, SLOTS, sizeof *slot) : NULL;
    if (!slot) return SHERF_NO_MEMORY;
    a->h_blocks = (n->s.decoder_width + 31) / 32;
    a->x_blocks = (n->position_width + 3 + WIDTH + 31) / 32;
    a->v_blocks = (n->direction_width + 3 + WIDTH + 31) / 32;
    a->mixed_blocks = (n->attention_width + 2 + 31) / 32;
    sherf_status status = pack_fusion(c, n, m, slot, a);
    if (!status) status = pack_decoder(c, n, m, slot, a);
    mem_free(slot);
    lay_out(n, a);
    n->tile = tile_amx;
    return status;
}

static void tiles_free(tiles *l) {
    mem_free(l->w);
    mem_free(l->bias);
}

void point_amx_free(point_amx *a) {
    if (!a) return;
    tiles *all[] = {&a->color, &a->qkv, &a->attention_out, &a->mlp0, &a->mlp1, &a->views, &a->alpha, &a->rgb};
    for (size_t i = 0; i < COUNT_OF(all); i++) tiles_free(all[i]);
    for (int i = 0; i < POINT_DECODER_MAX; i++) tiles_free(&a->pts[i]);
    mem_free(a->mlp1_b);
    mem_free(a);
}
#else
typedef int nothing_here;
#endif
