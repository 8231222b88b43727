/* The backward tile of the radiance field for AMX with AVX512-FP16 (the build compiles this file for them).
 *
 * Gradients of activations go through the same products as the activations, with transposed weights.
 * Gradients of weights sum over points, dW = dY X^T: an A tile is 16 outputs x 32 points, a B tile 16 pairs
 * of points x 16 inputs. A pair is the same place in two groups of 16 points, so that the rows for A come out
 * of activation buffers with shifts alone; the columns for B are those rows transposed. */
#if (defined(__AMX_BF16__) || defined(__AMXBF16__)) && defined(__AVX512FP16__) /* clang 14 says AMXBF16 */
#include "model/sherf/fused/train_amx.h"

#define AMX_GROUPS (TRAIN_POINTS / 16)
#include "model/sherf/fused/tile_amx.h"

enum {
    ONE = WIDTH * GROUP,
    ALL = 3 * ONE,
    ITEMS = 3 * AMX_GROUPS, /* maximum number of groups of points: every token's */
    PART_GROUPS = POINT_TILE / GROUP
};

/* Everything of one tile, in its thread's scratch; sums are float32, the others bf16. */
typedef struct {
    samples *samples;
    float *row, *sums;
    float *token, *x0, *x1; /* [group][3 x 32][16]: after the transformer; before; after attention */
    float *qkv;             /* [group][token][row][16] */
    float *chance;          /* [group][head][2][3][16] */
    float *pre;             /* [group][2][32][16]: before GELU */
    char *color, *normed0, *mixed, *normed1, *gelu; /* [group][token]... */
    channels x, v, h[POINT_DECODER_MAX], views;
    /* gradients */
    char *drgb;
    channels dviews, dh[2];
    float *dtoken;                           /* [group][3 x 32][16] */
    char *dlast, *dpre, *dattended, *dcolor; /* [token][group] tiles */
    char *dqkv;                              /* [token][group][qkv_blocks] tiles */
    char *rows, *columns;
} space;

/* ---- gradients of weights ---- */
typedef struct {
    const char *at[ITEMS]; /* the activation buffer of every group */
    int count;             /* even */
} groups;

static groups groups_of(channels x) {
    groups g = {.count = AMX_GROUPS};
    for (int i = 0; i < AMX_GROUPS; i++) g.at[i] = x.at + (size_t)i * x.pitch;
    return g;
}

/* Of `tokens` tokens; strides in bytes. */
static groups groups_of_tokens(const char *x, int tokens, size_t token, size_t group) {
    groups g = {.count = tokens * AMX_GROUPS};
    for (int i = 0; i < g.count; i++)
        g.at[i] = x + (size_t)(i / AMX_GROUPS) * token + (size_t)(i % AMX_GROUPS) * group;
    return g;
}

/* Channels 2r and 2r + 1 of two groups, as [pair of points][2]. */
static inline void unpair(const char *a, const char *b, __m512i *even, __m512i *odd) {
    __m512i u = _mm512_load_si512(a), v = _mm512_load_si512(b);
    *even = _mm512_mask_blend_epi16(0xAAAAAAAAu, u, _mm512_slli_epi32(v, 16));
    *odd = _mm512_mask_blend_epi16(0xAAAAAAAAu, _mm512_srli_epi32(u, 16), v);
}

/* rows: [row tile][pair of groups][16 channels][32 points]; sums (or NULL) [channel][16] += the rows. */
static void to_rows(const groups *g, int blocks, char *rows, float *sums) {
    const int chunks = g->count / 2;
    const __m512bh ones = (__m512bh)_mm512_set1_epi32(0x3f803f80);
    for (int b = 0; b < blocks; b++)
        for (int r = 0; r < 16; r++) {
            const size_t from = (size_t)b * TILE + (size_t)r * PAIR;
            char *out = rows + ((size_t)(2 * b + (r >> 3)) * (size_t)chunks) * TILE + (size_t)(r & 7) * 128;
            __m512 s = _mm512_setzero_ps(), t = s;
            for (int k = 0; k < chunks; k++) {
                __m512i even, odd;
                unpair(g->at[2 * k] + from, g->at[2 * k + 1] + from, &even, &odd);
                _mm512_store_si512(out + (size_t)k * TILE, even);
                _mm512_store_si512(out + (size_t)k * TILE + 64, odd);
                s = _mm512_dpbf16_ps(s, (__m512bh)even, ones);
                t = _mm512_dpbf16_ps(t, (__m512bh)odd, ones);
            }
            if (!sums) continue;
            float *y = sums + (b * 32 + 2 * r) * 16;
            _mm512_store_ps(y, _mm512_add_ps(_mm512_load_ps(y), s));
            _mm512_store_ps(y + 16, _mm512_add_ps(_mm512_load_ps(y + 16), t));
        }
}

/* columns: [column tile][pair of groups][16 pairs of points][16 channels][2] */
static void to_columns(const groups *g, int blocks, char *columns) {
    const int chunks = g->count / 2;
    for (int b = 0; b < 2 * blocks; b++)
        for (int k = 0; k < chunks; k++, columns += TILE) {
            const char *u = g->at[2 * k] + (size_t)b * (TILE / 2),
                       *v = g->at[2 * k + 1] + (size_t)b * (TILE / 2);
            __m512i r[16];
#pragma GCC unroll 8
            for (int i = 0; i < 8; i++) unpair(u + i * PAIR, v + i * PAIR, &r[2 * i], &r[2 * i + 1]);
            transpose_16x16(r);
#pragma GCC unroll 16
            for (int i = 0; i < 16; i++) _mm512_store_si512(columns + i * 64, r[i]);
        }
}

/* Adds the matrix's gradient to the lane: dy x^T over all groups; its bias' += dy's sums unless with_ones. */
static void add_gradient(const space *s, float *lane, const sum_place *place, const groups *dy,
                         const groups *x) {
    const int chunks = dy->count / 2;
    const size_t strip = (size_t)chunks * TILE;
    to_rows(dy, place->padded_rows / 32, s->rows, lane + place->b);
    to_columns(x, place->padded_columns / 32, s->columns);
    ORDER();
    float *w = lane + place->w;
    for (int o = 0; o < place->padded_rows / 16; o += 2)
        for (int i = 0; i < place->padded_columns / 16; i += 2, w += 1024) {
            const char *a = s->rows + (size_t)o * strip, *b = s->columns + (size_t)i * strip;
            tile_load(0, w, 64);
            tile_load(1, w + 256, 64);
            tile_load(2, w + 512, 64);
            tile_load(3, w + 768, 64);
            for (int k = 0; k < chunks; k++, a += TILE, b += TILE) {
                tile_load(4, a, 64);
                tile_load(6, b, 64);
                tile_product(0, 4, 6);
                tile_load(7, b + strip, 64);
                tile_product(1, 4, 7);
                tile_load(5, a + strip, 64);
                tile_product(2, 5, 6);
                tile_product(3, 5, 7);
            }
            _tile_stored(0, w, 64);
            _tile_stored(1, w + 256, 64);
            _tile_stored(2, w + 512, 64);
            _tile_stored(3, w + 768, 64);
        }
    ORDER();
}

/* y [row_tiles x 16][16] = W x, one group. */
static inline void sums_of(const tiles *l, const char *x, float *y) {
    const char *weight = (const char *)l->w;
    ORDER();
    for (int m = 0; m + 1 < l->row_tiles; m += 2, y += 512) {
        _tile_zero(0);
        _tile_zero(1);
        for (int k = 0; k < l->blocks; k++, weight += 2 * TILE) {
            tile_load(6, x + k * TILE, 64);
            tile_load(4, weight, 64);
            tile_product(0, 4, 6);
            tile_load(5, weight + TILE, 64);
            tile_product(1, 5, 6);
        }
        _tile_stored(0, y, 64);
        _tile_stored(1, y + 256, 64);
    }
    if (l->row_tiles & 1) {
        _tile_zero(0);
        for (int k = 0; k < l->blocks; k++, weight += TILE) {
            tile_load(6, x + k * TILE, 64);
            tile_load(4, weight, 64);
            tile_product(0, 4, 6);
        }
        _tile_stored(0, y, 64);
    }
    ORDER();
}

/* ---- forward pass, keeping what the backward pass needs ---- */
static void forward(const amx_trainer *r, const train_tile *t, space *s) {
    const radiance_field *n = r->base.n;
    const radiance_amx *a = n->amx;
    const size_t colors = (size_t)a->color.blocks * TILE, mixed = (size_t)a->mixed_blocks * TILE,
                 qkv = (size_t)a->qkv.row_tiles * 256;
    for (int g = 0; g < AMX_GROUPS; g++)
        sample_group(n, &t->part[g / PART_GROUPS], g % PART_GROUPS * GROUP, s->samples, s->row,
                     s->color + g * colors, s->token + g * ALL);
    memcpy(s->x0, s->token, AMX_GROUPS * ALL * sizeof(float));
    const __m512i ones = _mm512_set1_epi32(0x3f803f80);
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        _mm512_store_si512(s->mixed + (size_t)k * mixed + (size_t)n->attention_width * 32, ones);
    for (int k = 0; k < 3 * AMX_GROUPS; k++)
        norm_tile(s->token + k * ONE, n->norm0_w, n->norm0_b, s->normed0 + k * TILE);
    for (int g = 0; g < AMX_GROUPS; g++) {
        float *sums = s->qkv + (size_t)g * 3 * qkv;
        qkv_product(n, s->normed0 + g * 3 * TILE, sums);
        attention(n, sums, s->mixed + (size_t)g * 2 * mixed, s->chance + g * n->s.heads * 6 * GROUP);
    }
    ORDER();
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        add_product(&a->attention_out, s->mixed + (size_t)k * mixed,
                    s->token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
    memcpy(s->x1, s->token, AMX_GROUPS * ALL * sizeof(float));
    for (int k = 0; k < 2 * AMX_GROUPS; k++) {
        norm_tile(s->token + (k >> 1) * ALL + (k & 1) * ONE, n->norm1_w, n->norm1_b, s->normed1 + k * TILE);
        float *pre = s->pre + k * ONE;
        mlp_product(&a->mlp0, s->normed1 + k * TILE, pre);
        for (int c = 0; c < WIDTH; c += 2, pre += 2 * GROUP) {
            __m512 even = _mm512_add_ps(_mm512_load_ps(pre), _mm512_set1_ps(a->mlp0.bias[c])),
                   odd = _mm512_add_ps(_mm512_load_ps(pre + GROUP), _mm512_set1_ps(a->mlp0.bias[c + 1]));
            _mm512_store_ps(pre, even);
            _mm512_store_ps(pre + GROUP, odd);
            _mm512_store_si512(s->gelu + k * TILE + c * 32, pairs(gelu_16(even), gelu_16(odd)));
        }
    }
    ORDER();
    for (int k = 0; k < 2 * AMX_GROUPS; k++)
        add_product(&a->mlp1, s->gelu + k * TILE, s->token + (k >> 1) * ALL + (k & 1) * ONE);
    ORDER();
    for (int g = 0; g < AMX_GROUPS; g++) {
        const point_tile *part = &t->part[g / PART_GROUPS];
        const float *first = s->token + g * ALL;
        pack_input(part->position, g % PART_GROUPS, n->s.position_frequencies, first, a->mlp1_b, s->row,
                   s->x.at + (size_t)g * s->x.pitch, a->x_blocks);
        pack_input(part->direction, g % PART_GROUPS, n->s.direction_frequencies, first + ONE, a->mlp1_b,
                   s->row, s->v.at + (size_t)g * s->v.pitch + (size_t)a->h_blocks * TILE, a->v_blocks);
    }
    ORDER();
    waiting w = {0};
    channels in = s->x;
    for (int i = 0; i < n->s.decoder_depth; i++) {
        dense(&a->pts[i], in, s->h[i], 0, s->sums, &w);
        in = i == n->s.decoder_skip && i < n->s.decoder_depth - 1 ? s->x : s->h[i];
    }
    dense(&a->views, s->v, s->views, 0, s->sums, &w);
    finish_all(&w);
}

/* ---- backwards ---- */
/* out[token]: sums [group][32][16], one token; overwritten, or added to. */
static void token_sums(const tiles *l, channels dy, float *out, bool add) {
    ORDER();
    for (int g = 0; g < AMX_GROUPS; g++) {
        if (add)
            add_product(l, dy.at + (size_t)g * dy.pitch, out + g * ALL);
        else
            sums_of(l, dy.at + (size_t)g * dy.pitch, out + g * ALL);
    }
    ORDER();
}

/* Backward through a dense layer and the ReLU before it, whose result `x` is; the sums are rounded on return.
 */
static channels back(const tiles *l, channels dy, channels x, channels out, float *sums) {
    waiting w = {0};
    out.pitch = x.pitch;
    dense(l, dy, out, x.at - out.at, sums, &w);
    finish_all(&w);
    return out;
}

static void decoder_back(const amx_trainer *r, const train_tile *t, space *s, float *lane) {
    const radiance_field *n = r->base.n;
    const int last = n->s.decoder_depth - 1, skip = n->s.decoder_skip;
    const channels drgb = {s->drgb, TILE};
    groups dy = groups_of(drgb), x = groups_of(s->views);
    char *alpha = s->dviews.at + (size_t)r->view_blocks * TILE;
    for (int g = 0; g < AMX_GROUPS; g++) {
        const float *d = t->dout[0] + g * GROUP;
        const __m512 zero = _mm512_setzero_ps();
        _mm512_store_si512(s->drgb + g * TILE, pairs(_mm512_load_ps(d), _mm512_load_ps(d + TRAIN_POINTS)));
        _mm512_store_si512(s->drgb + g * TILE + PAIR, pairs(_mm512_load_ps(d + 2 * TRAIN_POINTS), zero));
        _mm512_store_si512(alpha + (size_t)g * s->dviews.pitch,
                           pairs(_mm512_load_ps(d + 3 * TRAIN_POINTS), zero));
    }
    ORDER();
    add_gradient(s, lane, &r->base.sum.rgb, &dy, &x);
    /* views and alpha side by side; the buffer's groups have the layout of views' */
    waiting w = {0};
    dense(&r->back.rgb, drgb, s->dviews, s->views.at - s->dviews.at, s->sums, &w);
    finish_all(&w);
    dy = groups_of(s->dviews);
    x = groups_of(s->v);
    add_gradient(s, lane, &r->base.sum.views, &dy, &x);
    token_sums(&r->back.token1, s->dviews, s->dtoken + ONE, false);
    channels dh = back(&r->back.views, s->dviews, s->h[last], s->dh[0], s->sums);
    for (int i = last; i >= 0; i--) {
        channels in = i == 0 || i - 1 == skip ? s->x : s->h[i - 1];
        dy = groups_of(dh);
        x = groups_of(in);
        add_gradient(s, lane, &r->base.sum.pts[i], &dy, &x);
        if (i - 1 == skip) token_sums(&r->back.skip_token0, dh, s->dtoken, false);
        if (i == 0)
            token_sums(&r->back.token0, dh, s->dtoken, skip >= 0);
        else
            dh = back(&r->back.pts[i], dh, s->h[i - 1], s->dh[(last - i + 1) & 1], s->sums);
    }
}

/* The derivative of x Phi(x). */
static inline __m512 gelu_slope(__m512 x) {
    __m512 density = exp2_16(_mm512_mul_ps(_mm512_mul_ps(x, x), _mm512_set1_ps(-0.72134752f)));
    return _mm512_fmadd_ps(density, _mm512_mul_ps(x, _mm512_set1_ps(0.39894228f)), normal_share(x));
}

/* Backward through a layer norm of 32 channels: dx += its part; rows of partial sums for weight and bias. */
static inline void norm_back(const float *x, const float *dy, const float *weight, float *dx, float *dweight,
                             float *dbias) {
    __m512 sum = _mm512_setzero_ps(), square = sum, share = sum, along = sum;
    const __m512 part = _mm512_set1_ps(1.0f / WIDTH);
    for (int c = 0; c < WIDTH; c++) {
        __m512 v = _mm512_load_ps(x + c * GROUP);
        sum = _mm512_add_ps(sum, v);
        square = _mm512_fmadd_ps(v, v, square);
    }
    __m512 mean = _mm512_mul_ps(sum, part);
    __m512 variance = _mm512_fnmadd_ps(mean, mean, _mm512_mul_ps(square, part));
    variance = _mm512_max_ps(variance, _mm512_setzero_ps());
    __m512 scale = _mm512_rsqrt14_ps(_mm512_add_ps(variance, _mm512_set1_ps(1e-5f)));
    __m512 shift = _mm512_mul_ps(mean, scale);
    for (int c = 0; c < WIDTH; c++) {
        __m512 unit = _mm512_fmsub_ps(_mm512_load_ps(x + c * GROUP), scale, shift),
               d = _mm512_load_ps(dy + c * GROUP);
        __m512 du = _mm512_mul_ps(d, _mm512_set1_ps(weight[c]));
        share = _mm512_add_ps(share, du);
        along = _mm512_fmadd_ps(du, unit, along);
        _mm512_store_ps(dweight + c * 16, _mm512_fmadd_ps(d, unit, _mm512_load_ps(dweight + c * 16)));
        _mm512_store_ps(dbias + c * 16, _mm512_add_ps(d, _mm512_load_ps(dbias + c * 16)));
    }
    share = _mm512_mul_ps(share, part);
    along = _mm512_mul_ps(along, part);
    for (int c = 0; c < WIDTH; c++) {
        __m512 unit = _mm512_fmsub_ps(_mm512_load_ps(x + c * GROUP), scale, shift);
        __m512 d = _mm512_fmsub_ps(_mm512_load_ps(dy + c * GROUP), _mm512_set1_ps(weight[c]), share);
        d = _mm512_fnmadd_ps(unit, along, d);
        _mm512_store_ps(dx + c * GROUP, _mm512_fmadd_ps(d, scale, _mm512_load_ps(dx + c * GROUP)));
    }
}

/* e: in, the gradients of the attention weights p; out, of the scores, which are in powers of 2 (q's weights
 * include log2 e), hence ln 2. */
static inline void softmax_back(__m512 p[2][3], __m512 e[2][3]) {
    for (int i = 0; i < 2; i++) {
        __m512 mean = _mm512_mul_ps(p[i][0], e[i][0]);
        mean = _mm512_fmadd_ps(p[i][1], e[i][1], mean);
        mean = _mm512_fmadd_ps(p[i][2], e[i][2], mean);
        for (int j = 0; j < 3; j++)
            e[i][j] = _mm512_mul_ps(_mm512_mul_ps(p[i][j], _mm512_set1_ps(0.69314718f)),
                                    _mm512_sub_ps(e[i][j], mean));
    }
}

/* Backward through the attention of one group: d [2 tokens][attention width][16] -> dqkv, bf16 [token]. */
static inline void attention_back(const radiance_field *n, const float *sums, const float *chance,
                                  const float *d, size_t d_token, char *dqkv, size_t dqkv_token) {
    const int head = n->s.head_width, all = n->attention_width;
    const size_t token = (size_t)n->amx->qkv.row_tiles * 256;
    const __m512 zero = _mm512_setzero_ps();
    for (int h = 0; h < n->s.heads; h++) {
        const int first = h * head;
        const float *q = sums + first * GROUP, *k = q + all * GROUP, *v = k + all * GROUP,
                    *dy = d + first * GROUP;
        __m512 p[2][3], e[2][3];
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 3; j++) {
                p[i][j] = _mm512_load_ps(chance + ((h * 2 + i) * 3 + j) * GROUP);
                e[i][j] = zero;
            }
        for (int c = 0; c < head; c += 2) {
            __m512 dv[3][2];
            for (int s = 0; s < 2; s++) {
                __m512 a = _mm512_load_ps(dy + (c + s) * GROUP),
                       b = _mm512_load_ps(dy + d_token + (c + s) * GROUP);
                for (int j = 0; j < 3; j++) {
                    __m512 value = _mm512_load_ps(v + (size_t)j * token + (c + s) * GROUP);
                    e[0][j] = _mm512_fmadd_ps(a, value, e[0][j]);
                    e[1][j] = _mm512_fmadd_ps(b, value, e[1][j]);
                    dv[j][s] = _mm512_fmadd_ps(p[1][j], b, _mm512_mul_ps(p[0][j], a));
                }
            }
            for (int j = 0; j < 3; j++)
                _mm512_store_si512(dqkv + (size_t)j * dqkv_token + (2 * all + first + c) * 32,
                                   pairs(dv[j][0], dv[j][1]));
        }
        softmax_back(p, e);
        for (int c = 0; c < head; c += 2) {
            __m512 dq[2][2], dk[3][2];
            for (int s = 0; s < 2; s++) {
                const float *key = k + (c + s) * GROUP, *query = q + (c + s) * GROUP;
                __m512 k0 = _mm512_load_ps(key), k1 = _mm512_load_ps(key + token),
                       k2 = _mm512_load_ps(key + 2 * token);
                __m512 q0 = _mm512_load_ps(query), q1 = _mm512_load_ps(query + token);
                for (int i = 0; i < 2; i++)
                    dq[i][s] = _mm512_fmadd_ps(e[i][2], k2,
                                               _mm512_fmadd_ps(e[i][1], k1, _mm512_mul_ps(e[i][0], k0)));
                for (int j = 0; j < 3; j++)
                    dk[j][s] = _mm512_fmadd_ps(e[1][j], q1, _mm512_mul_ps(e[0][j], q0));
            }
            char *to = dqkv + (first + c) * 32;
            for (int j = 0; j < 3; j++) {
                _mm512_store_si512(to + (size_t)j * dqkv_token,
                                   j < 2 ? pairs(dq[j][0], dq[j][1]) : _mm512_setzero_si512());
                _mm512_store_si512(to + (size_t)j * dqkv_token + all * 32, pairs(dk[j][0], dk[j][1]));
            }
        }
    }
}

static inline void pack_sums(const float *x, int rows, char *out) {
    for (int c = 0; c < rows; c += 2)
        _mm512_store_si512(out + c * 32,
                           pairs(_mm512_load_ps(x + c * GROUP), _mm512_load_ps(x + (c + 1) * GROUP)));
}

/* dtoken: in, of the transformer's result (tokens 0 and 1); out, of the sampled values. */
static void transformer_back(const amx_trainer *r, space *s, float *lane) {
    const radiance_field *n = r->base.n;
    const size_t one = AMX_GROUPS * TILE, wide = (size_t)r->qkv_blocks * TILE,
                 qkv = (size_t)n->amx->qkv.row_tiles * 256;
    float *sums = s->sums;
    for (int g = 0; g < AMX_GROUPS; g++)
        for (int k = 0; k < 2; k++) {
            float *d = s->dtoken + g * ALL + k * ONE;
            const float *pre = s->pre + (2 * g + k) * ONE;
            char *last = s->dlast + k * one + g * TILE, *dpre = s->dpre + k * one + g * TILE,
                 *attended = s->dattended + k * one + g * TILE;
            pack_sums(d, WIDTH, last);
            sums_of(&r->back.mlp1, last, sums);
            for (int c = 0; c < WIDTH; c++)
                _mm512_store_ps(sums + c * GROUP, _mm512_mul_ps(_mm512_load_ps(sums + c * GROUP),
                                                                gelu_slope(_mm512_load_ps(pre + c * GROUP))));
            pack_sums(sums, WIDTH, dpre);
            sums_of(&r->back.mlp0, dpre, sums);
            norm_back(s->x1 + g * ALL + k * ONE, sums, n->norm1_w, d, lane + r->base.norm1_w,
                      lane + r->base.norm1_b);
            pack_sums(d, WIDTH, attended);
        }
    for (int g = 0; g < AMX_GROUPS; g++) {
        char *dqkv = s->dqkv + (size_t)g * wide;
        const size_t width = (size_t)r->back.attention_out.row_tiles * 256;
        for (int k = 0; k < 2; k++)
            sums_of(&r->back.attention_out, s->dattended + k * one + g * TILE, sums + (size_t)k * width);
        attention_back(n, s->qkv + (size_t)g * 3 * qkv, s->chance + g * n->s.heads * 6 * GROUP, sums, width,
                       dqkv, AMX_GROUPS * wide);
        memset(s->dtoken + g * ALL + 2 * ONE, 0, ONE * sizeof(float));
        for (int k = 0; k < 3; k++) {
            sums_of(&r->back.qkv, dqkv + (size_t)k * AMX_GROUPS * wide, sums);
            norm_back(s->x0 + g * ALL + k * ONE, sums, n->norm0_w, s->dtoken + g * ALL + k * ONE,
                      lane + r->base.norm0_w, lane + r->base.norm0_b);
        }
    }
    const size_t mixed = (size_t)n->amx->mixed_blocks * TILE;
    groups dy = groups_of_tokens(s->dlast, 2, one, TILE), x = groups_of_tokens(s->gelu, 2, TILE, 2 * TILE);
    add_gradient(s, lane, &r->base.sum.mlp1, &dy, &x);
    dy = groups_of_tokens(s->dpre, 2, one, TILE);
    x = groups_of_tokens(s->normed1, 2, TILE, 2 * TILE);
    add_gradient(s, lane, &r->base.sum.mlp0, &dy, &x);
    dy = groups_of_tokens(s->dattended, 2, one, TILE);
    x = groups_of_tokens(s->mixed, 2, mixed, 2 * mixed);
    add_gradient(s, lane, &r->base.sum.attention_out, &dy, &x);
    dy = groups_of_tokens(s->dqkv, 3, AMX_GROUPS * wide, wide);
    x = groups_of_tokens(s->normed0, 3, TILE, 3 * TILE);
    add_gradient(s, lane, &r->base.sum.qkv, &dy, &x);
}

/* The gradients of the sampled tokens: biases, the colour's layer, and rows for the points. */
static void sampled_back(const amx_trainer *r, train_tile *t, space *s, float *lane) {
    const radiance_field *n = r->base.n;
    for (int c = 0; c < 3 * WIDTH; c++) {
        float *b = lane + r->base.token_b + c * 16;
        __m512 sum = _mm512_load_ps(b);
        for (int g = 0; g < AMX_GROUPS; g++)
            sum = _mm512_add_ps(sum, _mm512_load_ps(s->dtoken + g * ALL + c * GROUP));
        _mm512_store_ps(b, sum);
    }
    if (n->color_width) {
        const size_t blocks = (size_t)r->color_tokens * TILE;
        for (int g = 0; g < AMX_GROUPS; g++)
            pack_sums(s->dtoken + g * ALL + n->color_token * ONE, r->color_tokens * WIDTH,
                      s->dcolor + (size_t)g * blocks);
        groups dy = groups_of((channels){s->dcolor, blocks}),
               x = groups_of((channels){s->color, (size_t)n->amx->color.blocks * TILE});
        add_gradient(s, lane, &r->base.sum.color, &dy, &x);
    }
    for (int g = 0; g < AMX_GROUPS && g * GROUP < t->count; g++)
        for (int c = 0; c < 3 * WIDTH; c += 16) {
            __m512i row[16];
            for (int i = 0; i < 16; i++) row[i] = _mm512_load_si512(s->dtoken + g * ALL + (c + i) * GROUP);
            transpose_16x16(row);
            for (int i = 0; i < 16 && g * GROUP + i < t->count; i++)
                _mm512_storeu_si512(t->dtoken + (g * GROUP + i) * 3 * WIDTH + c, row[i]);
        }
}

/* ---- the scratch ---- */
/* Allocates scratch from its start; without a base it only counts. */
typedef struct {
    char *base;
    size_t used;
} room;

static void *take(room *r, size_t bytes) {
    void *p = r->base ? r->base + r->used : NULL;
    r->used += (bytes + 63) / 64 * 64;
    return p;
}

static channels take_channels(room *r, int blocks, size_t min) {
    const size_t pitch = (size_t)blocks * TILE + 64; /* one more line: see lay_out in amx_pack.c */
    return (channels){take(r, AMX_GROUPS * (pitch > min ? pitch : min)), pitch};
}

static int larger(int a, int b) {
    return a > b ? a : b;
}

static void lay_out(const amx_trainer *t, room *r, space *s) {
    const radiance_field *n = t->base.n;
    const radiance_amx *a = n->amx;
    const size_t G = AMX_GROUPS, tokens = G * ALL * sizeof(float);
    const int last = n->s.decoder_depth - 1, h = a->h_blocks;
    s->samples = take(r, sizeof(samples));
    s->row = take(r, (6 + 6 * 16) * GROUP * sizeof(float));
    s->sums = take(r, (size_t)larger(2 * t->back.attention_out.row_tiles, 8) * TILE);
    s->token = take(r, tokens);
    s->x0 = take(r, tokens);
    s->x1 = take(r, tokens);
    s->dtoken = take(r, tokens);
    s->qkv = take(r, G * 3 * (size_t)a->qkv.row_tiles * TILE);
    s->chance = take(r, G * (size_t)n->s.heads * 6 * GROUP * sizeof(float));
    s->pre = take(r, G * 2 * ONE * sizeof(float));
    s->color = take(r, G * (size_t)a->color.blocks * TILE);
    s->normed0 = take(r, G * 3 * TILE);
    s->mixed = take(r, G * 2 * (size_t)a->mixed_blocks * TILE);
    s->normed1 = take(r, G * 2 * TILE);
    s->gelu = take(r, G * 2 * TILE);
    s->x = take_channels(r, a->x_blocks + h, 0);
    s->v = take_channels(r, h + a->v_blocks, 0);
    for (int i = 0; i <= last; i++) {
        if (i == last)
            s->h[i] = s->v;
        else if (i == n->s.decoder_skip)
            s->h[i] = (channels){r->base ? s->x.at + (size_t)a->x_blocks * TILE : NULL, s->x.pitch};
        else
            s->h[i] = take_channels(r, h, 0);
    }
    s->views = take_channels(r, t->view_blocks + 1, 0); /* as wide as dviews, which ends with alpha */
    s->dviews = take_channels(r, t->view_blocks + 1, 0);
    for (int i = 0; i < 2; i++)
        s->dh[i] = take_channels(r, h, s->x.pitch > s->v.pitch ? s->x.pitch : s->v.pitch);
    s->drgb = take(r, G * TILE);
    s->dlast = take(r, 2 * G * TILE);
    s->dpre = take(r, 2 * G * TILE);
    s->dattended = take(r, 2 * G * TILE);
    s->dcolor = take(r, 3 * G * TILE);
    s->dqkv = take(r, 3 * G * (size_t)t->qkv_blocks * TILE);
    /* the widest products: tiles of the decoder's G / 2 pairs of groups, of the tokens' three times as many
     */
    const int rows = larger(larger(2 * h, 2 * t->view_blocks + 2), 6 * t->qkv_blocks);
    const int columns = larger(2 * (h + larger(a->x_blocks, a->v_blocks)), 6 * a->mixed_blocks);
    s->rows = take(r, (size_t)rows * (G / 2) * TILE);
    s->columns = take(r, (size_t)columns * (G / 2) * TILE);
}

size_t radiance_train_scratch_bytes(const amx_trainer *t) {
    space s;
    room r = {0};
    lay_out(t, &r, &s);
    return r.used;
}

/* The scratch starts as zeros: values that no pass writes (padding) stay 0. */
void radiance_train_tile_amx(const radiance_trainer *base, train_tile *t, float *lane, void *scratch) {
    const amx_trainer *r = (const amx_trainer *)base;
    space s;
    lay_out(r, &(room){.base = scratch}, &s);
    tiles_begin();
    forward(r, t, &s);
    decoder_back(r, t, &s, lane);
    transformer_back(r, &s, lane);
    sampled_back(r, t, &s, lane);
    _tile_release();
}

/* ---- the bank ---- */
static inline void add_row(float *row, __m512 weight, __m512 a, __m512 b) {
    _mm512_storeu_ps(row, _mm512_fmadd_ps(weight, a, _mm512_loadu_ps(row)));
    _mm512_storeu_ps(row + 16, _mm512_fmadd_ps(weight, b, _mm512_loadu_ps(row + 16)));
}

static inline __m512 one_weight(const int32_t *w) {
    return _mm512_castsi512_ps(_mm512_set1_epi32(*w));
}

typedef struct {
    __m512 position[3], pixel[2];
    int count;
} sixteen;

static inline sixteen points_at(const point_set *points, const int32_t *index, int64_t left) {
    sixteen s = {.count = left < GROUP ? (int)left : GROUP};
    const __mmask16 mask = (__mmask16)((1u << s.count) - 1);
    const __m512 zero = _mm512_setzero_ps();
    const __m512i i = _mm512_maskz_loadu_epi32(mask, index), i3 = _mm512_add_epi32(i, _mm512_add_epi32(i, i));
    for (int k = 0; k < 3; k++)
        s.position[k] = _mm512_mask_i32gather_ps(zero, mask, i3, points->canonical + k, 4);
    for (int k = 0; k < 2; k++)
        s.pixel[k] = _mm512_mask_i32gather_ps(zero, mask, _mm512_add_epi32(i, i), points->observed_px + k, 4);
    return s;
}

static void scatter_level(const radiance_level *l, const float *volume_min, int token,
                          const point_set *points, const int32_t *index, int64_t count, const float *dtoken,
                          float *out) {
    samples s;
    for (int64_t first = 0; first < count; first += GROUP) {
        sixteen at = points_at(points, index + first, count - first);
        for (int k = 0; k < 3; k++)
            at.position[k] = _mm512_sub_ps(at.position[k], _mm512_set1_ps(volume_min[k]));
        level_taps(l, &s, 0, at.position, false);
        for (int p = 0; p < at.count; p++) {
            if (s.cell[0][p] < 0) continue;
            const float *d = dtoken + (first + p) * 3 * WIDTH + token * WIDTH;
            const __m512 a = _mm512_loadu_ps(d), b = _mm512_loadu_ps(d + 16);
            const int32_t *corner = l->corner[s.cell[0][p]];
            for (int k = 0; k < 8; k++)
                if (corner[k])
                    add_row(out + (size_t)(corner[k] - 1) * 3 * WIDTH + token * WIDTH,
                            one_weight(&s.cell_weight[0][k][p]), a, b);
        }
    }
}

/* x, y: which value of `sixteen` runs along the map and its texel = (value - low) * scale - shift. */
typedef struct {
    int width, height, stride;
    float scale[2], shift[2];
} texels;

static void scatter_map(const texels *texture, const int axis[2], bool pixel, int token,
                        const point_set *points, const int32_t *index, int64_t count, const float *dtoken,
                        float *out) {
    samples s;
    for (int64_t first = 0; first < count; first += GROUP) {
        sixteen at = points_at(points, index + first, count - first);
        __m512 x[2];
        for (int i = 0; i < 2; i++)
            x[i] = _mm512_fmsub_ps(pixel ? at.pixel[i] : at.position[axis[i]],
                                   _mm512_set1_ps(texture->scale[i]), _mm512_set1_ps(texture->shift[i]));
        map_taps(&s, 0, texture->width, texture->height, 1, x[0], x[1], false);
        for (int p = 0; p < at.count; p++) {
            const float *d = dtoken + (first + p) * 3 * WIDTH + token * WIDTH;
            const __m512 a = _mm512_loadu_ps(d), b = _mm512_loadu_ps(d + 16);
            for (int k = 0; k < 4; k++)
                add_row(out + (size_t)(uint32_t)s.offset[k][p] * (size_t)texture->stride,
                        one_weight(&s.weight[k][p]), a, b);
        }
    }
}

void radiance_scatter_amx(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                          int64_t count, const float *dtoken, const radiance_gradients *out) {
    const int which = job / 3, token = job % 3;
    if (which < POINT_LEVELS) {
        scatter_level(&n->level[which], n->volume_min, token, points, index, count, dtoken,
                      out->level[which]);
    } else if (which == POINT_LEVELS) {
        texels texture = {n->plane[token].width, n->plane[token].height, WIDTH, {0}, {0}};
        for (int i = 0; i < 2; i++) {
            const int a = plane_axis[token][i];
            texture.scale[i] = n->plane_scale[a];
            texture.shift[i] = n->plane_min[a] * n->plane_scale[a] + 0.5f;
        }
        scatter_map(&texture, plane_axis[token], false, token, points, index, count, dtoken,
                    out->plane[token]);
    } else if (token < n->map_tokens) {
        const texels texture = {
            n->map.width, n->map.height, n->map_tokens * WIDTH, {n->map_scale[0], n->map_scale[1]}, {0}};
        scatter_map(&texture, NULL, true, token, points, index, count, dtoken, out->map + token * WIDTH);
    }
}
#else
typedef int nothing_here;
#endif
