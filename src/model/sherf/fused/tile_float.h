/* The float32 tile: included by one file per instruction set, which defines LANES (floats per vector), ROWS x
 * VECTORS (the block of outputs that a product keeps in registers) and KERNELS, the name of what it gives.
 * Activations are [channel][POINT_TILE]: all arithmetic runs across points. */
#include <math.h>
#include <string.h>

#include "base/simd.h"
#include "model/sherf/fused/float_sample.h"
#include "model/sherf/fused/float_token.h"
#include "model/sherf/fused/inside.h"

enum { PARTS = POINT_TILE / LANES };

/* ---- y[rows][tile] = w x + b, with ReLU; x[columns][tile] ---- */
/* rows: a constant where this is inlined, so that the sums stay in registers. */
static inline __attribute__((always_inline)) void block_product(const int rows, const float *w,
                                                                const float *b, const float *x, int columns,
                                                                float *y, bool relu) {
    vf sum[ROWS][VECTORS];
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < VECTORS; v++) sum[r][v] = splat(b[r]);
    for (int k = 0; k < columns; k++, w += rows, x += POINT_TILE) {
        vf in[VECTORS];
        for (int v = 0; v < VECTORS; v++) in[v] = ((const vf *)x)[v];
        numbers some[ROWS];
        for (int i = 0; i < rows / NUMBERS; i++) some[i] = numbers_load(w + i * NUMBERS);
        for (int r = 0; r < rows; r++) {
            const vf weight =
                r < rows / NUMBERS * NUMBERS ? number(some[r / NUMBERS], r % NUMBERS) : splat(w[r]);
            for (int v = 0; v < VECTORS; v++) sum[r][v] += weight * in[v];
        }
    }
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < VECTORS; v++)
            ((vf *)(y + (size_t)r * POINT_TILE))[v] = relu ? max_lanes(sum[r][v], splat(0)) : sum[r][v];
}

/* Rows from `from` (a multiple of ROWS) on; y is that of row 0. */
static void product_from(const radiance_layer *l, int from, const float *x, float *y, bool relu) {
#define BLOCK(n) block_product(n, w, b, x + p, l->columns, out, relu)
    for (int p = 0; p < POINT_TILE; p += VECTORS * LANES)
        for (int r = from; r < l->rows; r += ROWS) {
            const float *w = l->w + (size_t)r * l->columns, *b = l->b + r;
            float *out = y + (size_t)r * POINT_TILE + p;
            switch (l->rows - r) {
            case 1:
                BLOCK(1);
                break;
            case 2:
                BLOCK(2);
                break;
            case 3:
                BLOCK(3);
                break;
#if ROWS > 4
            case 4:
                BLOCK(4);
                break;
            case 5:
                BLOCK(5);
                break;
#endif
#if ROWS > 6
            case 6:
                BLOCK(6);
                break;
            case 7:
                BLOCK(7);
                break;
#endif
            default:
                BLOCK(ROWS);
            }
        }
#undef BLOCK
}

static void product(const radiance_layer *l, const float *x, float *y, bool relu) {
    product_from(l, 0, x, y, relu);
}

/* ---- encodings and the transformer, one token's rows at a time ---- */
static void encode(const float x[3][POINT_TILE], int frequencies, int width, float *out) {
    for (int i = 0; i < 3; i++)
        for (int v = 0; v < PARTS; v++)
            encode_component(((const vf *)x[i])[v], i, frequencies, width, (vf *)out + v, PARTS);
}

static void layer_norm(const float *x, int width, const float *weight, const float *bias, float *y) {
    for (int v = 0; v < PARTS; v++) norm_vector((const vf *)x + v, width, weight, bias, (vf *)y + v, PARTS);
}

static void attention(const radiance_field *n, const float *qkv, float *out) {
    for (int h = 0; h < n->s.heads; h++)
        for (int v = 0; v < PARTS; v++) {
            const size_t first = (size_t)(h * n->s.head_width) * PARTS + (size_t)v;
            attention_head(n, (const vf *)qkv + first, NULL, (vf *)out + first, PARTS);
        }
}

static void add_rows(float *x, const float *y, int rows) {
    for (int i = 0; i < rows * PARTS; i++) ((vf *)x)[i] += ((const vf *)y)[i];
}

/* token[3 D][tile], tokens 0 and 1 in place; a and b are scratch of 3 x 3 attention_width and 3
 * attention_width rows (or 3 D where that is more). */
static void transformer(const radiance_field *n, float *token, float *a, float *b) {
    int width = n->s.token_width, all = n->attention_width;
    for (int i = 0; i < 3; i++) {
        layer_norm(token + i * width * POINT_TILE, width, n->norm0_w, n->norm0_b, b);
        product_from(&n->qkv, i < 2 ? 0 : all / ROWS * ROWS, b, a + (size_t)(i * 3 * all) * POINT_TILE,
                     false);
    }
    attention(n, a, b);
    for (int i = 0; i < 2; i++) {
        float *x = token + i * width * POINT_TILE;
        product(&n->attention_out, b + (size_t)(i * all) * POINT_TILE, a, false);
        add_rows(x, a, width);
        layer_norm(x, width, n->norm1_w, n->norm1_b, a);
        float *hidden = a + width * POINT_TILE;
        product(&n->mlp0, a, hidden, false);
        for (int k = 0; k < width * PARTS; k++) ((vf *)hidden)[k] = gelu_lanes(((vf *)hidden)[k]);
        product(&n->mlp1, hidden, a, false);
        add_rows(x, a, width);
    }
}

/* ---- the decoder ---- */
/* x holds PE(position), token 0 and then room for h; v: room for h, then PE(direction), token 1 */
static void decoder(const radiance_field *n, float *x, float *v, float *a, float *b, point_tile *t) {
    const radiance_sizes *s = &n->s;
    float *behind = x + (size_t)(n->position_width + s->token_width) * POINT_TILE;
    const float *in = x;
    for (int i = 0; i < s->decoder_depth; i++) {
        bool last = i == s->decoder_depth - 1, skip = i == s->decoder_skip && !last;
        float *out = last ? v : skip ? behind : in == a ? b : a;
        product(&n->pts[i], in, out, true);
        in = skip ? x : out;
    }
    product(&n->alpha, v, t->out[3], false);
    product(&n->views, v, a, true);
    product(&n->rgb, a, t->out[0], false);
    for (int i = 0; i < 3 * PARTS; i++) {
        vf *y = (vf *)t->out[0] + i;
        *y = 1.002f / (1.0f + exp_lanes(-*y)) - 0.001f;
    }
}

static inline int more(int a, int b) {
    return a > b ? a : b;
}

static void tile(const radiance_field *n, point_tile *t, void *scratch) {
    const radiance_sizes *s = &n->s;
    int width = s->token_width;
    float *token = scratch;
    float *x = token + (size_t)n->fused * POINT_TILE;
    float *v = x + (size_t)(n->position_width + width + s->decoder_width) * POINT_TILE;
    float *b = v + (size_t)(s->decoder_width + n->direction_width + width) * POINT_TILE;
    int b_rows = more(3 * n->attention_width, more(s->decoder_width, more(n->fused, n->color_width + 6)));
    float *a = b + (size_t)b_rows * POINT_TILE;
    float color[3][POINT_TILE] __attribute__((aligned(64)));
    memset(color, 0, sizeof color);
    memset(token, 0, (size_t)n->fused * POINT_TILE * sizeof(float));
    for (int first = 0; first < t->count; first += 4) { /* `a` holds four points' tokens here */
        int pitch = round_up(n->fused, 16) + 16;
        float rgb[4];
        for (int p = 0; p < 4; p++) {
            sample_point(n, t, first + p, a + p * pitch, rgb);
            for (int i = 0; i < 3; i++) color[i][first + p] = rgb[i];
        }
        for (int i = 0; i < n->fused; i++)
            for (int p = 0; p < 4; p++) token[i * POINT_TILE + first + p] = a[p * pitch + i];
    }
    if (n->color_width) {
        encode((const float(*)[POINT_TILE])color, s->color_frequencies, n->color_width, b);
        product(&n->color, b, a, false);
        add_rows(token + n->color_token * width * POINT_TILE, a, (3 - n->color_token) * width);
    }
    transformer(n, token, a, b);
    encode((const float(*)[POINT_TILE])t->position, s->position_frequencies, n->position_width, x);
    memcpy(x + n->position_width * POINT_TILE, token, (size_t)width * POINT_TILE * sizeof(float));
    float *direction = v + s->decoder_width * POINT_TILE;
    encode((const float(*)[POINT_TILE])t->direction, s->direction_frequencies, n->direction_width, direction);
    memcpy(direction + n->direction_width * POINT_TILE, token + width * POINT_TILE,
           (size_t)width * POINT_TILE * sizeof(float));
    decoder(n, x, v, a, b, t);
}

/* ---- the bank ---- */
/* Rows in one pass: their sums stay in registers. */
enum { PROJECTED = LANES == 4 ? 2 : 4 };

/* COUNT rows of x through one block of POINT_PAD columns. */
#define PROJECT_ROWS(COUNT)                                                                                  \
    do {                                                                                                     \
        vf sum[COUNT][POINT_PAD / LANES] = {0};                                                              \
        for (int k = 0; k < columns; k++)                                                                    \
            for (int v = 0; v < POINT_PAD / LANES; v++) {                                                    \
                const vf w = *(const vf_any *)(m + k * POINT_PAD + v * LANES);                               \
                for (int i = 0; i < COUNT; i++) sum[i][v] += x[(int64_t)i * columns + k] * w;                \
            }                                                                                                \
        for (int i = 0; i < COUNT; i++)                                                                      \
            for (int v = 0; v < POINT_PAD / LANES; v++)                                                      \
                *(vf_any *)(y + (int64_t)i * stride + v * LANES) = sum[i][v];                                \
    } while (0)

static void project(const float *from, int64_t rows, int columns, const float *m, int stride, float *to) {
    for (int block = 0; block < stride; block += POINT_PAD, m += (size_t)columns * POINT_PAD) {
        const float *x = from;
        float *y = to + block;
        int64_t r = 0;
        for (; r + PROJECTED <= rows; r += PROJECTED) {
            PROJECT_ROWS(PROJECTED);
            x += PROJECTED * (int64_t)columns;
            y += PROJECTED * (int64_t)stride;
        }
        for (; r < rows; r++, x += columns, y += stride) PROJECT_ROWS(1);
    }
}

const radiance_kernels KERNELS = {ROWS, tile, project};
