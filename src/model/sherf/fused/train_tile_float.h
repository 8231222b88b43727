/* The float32 backward tile: included by one file per instruction set, which defines LANES (floats a vector),
 * ROWS x VECTORS (the block of sums that a product keeps in registers) and KERNELS, the name of what it
 * gives.
 *
 * Activations are [strip][channel][STRIP points], so that a product's block reads its inputs side by side.
 * Gradients of activations go through the same products with transposed weights. Gradients of weights sum
 * over points, dW = dY X^T: a block of them stays in registers while all points of the tile go by; dY is read
 * a value at a time, X as rows of inputs, which are the activations transposed. */
#include <string.h>

#include "base/simd.h"
#include "model/sherf/fused/float_sample.h"
#include "model/sherf/fused/float_token.h"
#include "model/sherf/fused/train_float.h"

enum { STRIP = LANES * VECTORS, STRIPS = POINT_TILE / STRIP, SQUARE = LANES < 8 ? 4 : 8 };
#define UNROLL _Pragma("GCC unroll 16")

typedef struct {
    float *at;
    size_t pitch; /* floats from strip to strip */
} channels;

INLINE channels from_channel(channels x, int channel) {
    return (channels){x.at + (size_t)channel * STRIP, x.pitch};
}

INLINE vf *row_of(channels x, int strip, int channel) {
    return (vf *)(x.at + (size_t)strip * x.pitch + (size_t)channel * STRIP);
}

/* ---- y = w x + b ---- */
typedef enum { AS_IT_IS, RELU, MASKED /* 0 where other is not above 0 */, ADDED /* to other */ } finish;

INLINE void block_product(const float *w, const float *b, const float *x, int columns, float *y,
                          const float *other, int rows, finish way) {
    vf sum[ROWS][VECTORS];
    UNROLL for (int r = 0; r < ROWS; r++) UNROLL for (int v = 0; v < VECTORS; v++) sum[r][v] = splat(b[r]);
    for (int k = 0; k < columns; k++, w += ROWS, x += STRIP) {
        vf in[VECTORS];
        UNROLL for (int v = 0; v < VECTORS; v++) in[v] = ((const vf *)x)[v];
        numbers some[ROWS];
        UNROLL for (int i = 0; i < ROWS / NUMBERS; i++) some[i] = numbers_load(w + i * NUMBERS);
        UNROLL for (int r = 0; r < ROWS; r++) {
            const vf weight =
                r < ROWS / NUMBERS * NUMBERS ? number(some[r / NUMBERS], r % NUMBERS) : splat(w[r]);
            UNROLL for (int v = 0; v < VECTORS; v++) sum[r][v] += weight * in[v];
        }
    }
    UNROLL for (int r = 0; r < ROWS; r++) UNROLL for (int v = 0; v < VECTORS; v++) {
        if (r >= rows) continue;
        const vf *with = (const vf *)(other + r * STRIP) + v;
        vf *to = (vf *)(y + r * STRIP) + v;
        if (way == AS_IT_IS) *to = sum[r][v];
        if (way == RELU) *to = max_lanes(sum[r][v], splat(0));
        if (way == MASKED) *to = (vf)((vi)sum[r][v] & (*with > 0.0f));
        if (way == ADDED) *to = *with + sum[r][v];
    }
}

/* Rows from the block of first_row on, of the inputs from first_column on. */
INLINE void product_way(const radiance_layer *l, int first_row, int first_column, channels x, channels y,
                        channels other, finish way) {
    for (int s = 0; s < STRIPS; s++)
        for (int r = first_row / ROWS * ROWS; r < l->rows; r += ROWS)
            block_product(l->w + (size_t)r * (size_t)l->columns + (size_t)first_column * ROWS, l->b + r,
                          (const float *)row_of(x, s, first_column), l->columns - first_column,
                          (float *)row_of(y, s, r), (const float *)row_of(other, s, r), l->rows - r, way);
}

static void product(const radiance_layer *l, int first_row, int first_column, channels x, channels y) {
    product_way(l, first_row, first_column, x, y, y, AS_IT_IS);
}
static void product_relu(const radiance_layer *l, channels x, channels y) {
    product_way(l, 0, 0, x, y, y, RELU);
}
static void product_masked(const radiance_layer *l, channels x, channels y, channels mask) {
    product_way(l, 0, 0, x, y, mask, MASKED);
}
static void product_added(const radiance_layer *l, channels x, channels y, channels to) {
    product_way(l, 0, 0, x, y, to, ADDED);
}

/* ---- gradients of weights ---- */
typedef float side __attribute__((vector_size(SQUARE * 4), may_alias, aligned(4)));

/* to [column][row] = from [row][column], SQUARE of each. */
INLINE void transpose_square(const float *from, size_t from_pitch, float *to, size_t to_pitch) {
    side r[SQUARE], t[SQUARE];
    UNROLL for (int i = 0; i < SQUARE; i++) r[i] = *(const side *)(from + (size_t)i * from_pitch);
#if LANES < 8
    UNROLL for (int i = 0; i < 2; i++) {
        t[2 * i] = __builtin_shufflevector(r[2 * i], r[2 * i + 1], 0, 4, 1, 5);
        t[2 * i + 1] = __builtin_shufflevector(r[2 * i], r[2 * i + 1], 2, 6, 3, 7);
    }
    UNROLL for (int i = 0; i < 2; i++) {
        r[2 * i] = __builtin_shufflevector(t[i], t[i + 2], 0, 1, 4, 5);
        r[2 * i + 1] = __builtin_shufflevector(t[i], t[i + 2], 2, 3, 6, 7);
    }
#else
    UNROLL for (int i = 0; i < 4; i++) {
        t[2 * i] = __builtin_shufflevector(r[2 * i], r[2 * i + 1], 0, 8, 1, 9, 4, 12, 5, 13);
        t[2 * i + 1] = __builtin_shufflevector(r[2 * i], r[2 * i + 1], 2, 10, 3, 11, 6, 14, 7, 15);
    }
    UNROLL for (int i = 0; i < 2; i++) UNROLL for (int k = 0; k < 2; k++) {
        const side a = t[4 * i + k], b = t[4 * i + 2 + k];
        r[4 * i + 2 * k] = __builtin_shufflevector(a, b, 0, 1, 8, 9, 4, 5, 12, 13);
        r[4 * i + 2 * k + 1] = __builtin_shufflevector(a, b, 2, 3, 10, 11, 6, 7, 14, 15);
    }
    UNROLL for (int i = 0; i < 4; i++) {
        t[i] = __builtin_shufflevector(r[i], r[i + 4], 0, 1, 2, 3, 8, 9, 10, 11);
        t[i + 4] = __builtin_shufflevector(r[i], r[i + 4], 4, 5, 6, 7, 12, 13, 14, 15);
    }
    UNROLL for (int i = 0; i < SQUARE; i++) r[i] = t[i];
#endif
    UNROLL for (int i = 0; i < SQUARE; i++) * (side *)(to + (size_t)i * to_pitch) = r[i];
}

/* to [columns][rows] = from [rows][columns], whole squares. */
INLINE void transpose(const float *from, int rows, int columns, size_t from_pitch, float *to,
                      size_t to_pitch) {
    for (int r = 0; r < rows; r += SQUARE)
        for (int k = 0; k < columns; k += SQUARE)
            transpose_square(from + (size_t)r * from_pitch + k, from_pitch, to + (size_t)k * to_pitch + r,
                             to_pitch);
}

/* w [ROWS][STRIP] += sum over points of dy [ROWS] x [STRIP]. */
INLINE void block_gradient(channels dy, const float *x, float *w) {
    vf sum[ROWS][VECTORS];
    UNROLL for (int r = 0; r < ROWS; r++) UNROLL for (int v = 0; v < VECTORS; v++) sum[r][v] =
        ((const vf *)(w + r * STRIP))[v];
    for (int s = 0; s < STRIPS; s++) {
        const float *d = dy.at + (size_t)s * dy.pitch;
        for (int p = 0; p < STRIP; p += NUMBERS) {
            numbers some[ROWS];
            UNROLL for (int r = 0; r < ROWS; r++) some[r] = numbers_load(d + r * STRIP + p);
            UNROLL for (int i = 0; i < NUMBERS; i++, x += STRIP) {
                vf in[VECTORS];
                UNROLL for (int v = 0; v < VECTORS; v++) in[v] = ((const vf *)x)[v];
                UNROLL for (int r = 0; r < ROWS; r++) UNROLL for (int v = 0; v < VECTORS; v++) sum[r][v] +=
                    number(some[r], i) * in[v];
            }
        }
    }
    UNROLL for (int r = 0; r < ROWS; r++) UNROLL for (int v = 0; v < VECTORS; v++)((vf *)(w + r * STRIP))[v] =
        sum[r][v];
}

/* sums [channels][LANES] += the channels' values at all points. */
static void add_sums(channels x, int count, float *sums) {
    for (int c = 0; c < count; c++) {
        vf sum = ((vf *)sums)[c];
        for (int s = 0; s < STRIPS; s++) UNROLL for (int v = 0; v < VECTORS; v++) sum += row_of(x, s, c)[v];
        ((vf *)sums)[c] = sum;
    }
}

/* Adds the matrix's gradient to the lane, from the block of first_row on: dy x^T; its bias' += dy's sums.
 * room: a panel of x. */
static void add_gradient(const sum_place *place, int first_row, channels dy, channels x, float *lane,
                         float *room) {
    add_sums(dy, place->rows, lane + place->b);
    float *w = lane + place->w;
    for (int k = 0; k < place->columns; k += STRIP, w += (size_t)place->padded_rows * STRIP) {
        for (int s = 0; s < STRIPS; s++)
            transpose((const float *)row_of(x, s, k), STRIP, STRIP, STRIP, room + s * STRIP * STRIP, STRIP);
        for (int r = first_row / ROWS * ROWS; r < place->rows; r += ROWS)
            block_gradient(from_channel(dy, r), room, w + (size_t)r * STRIP);
    }
}

/* ---- everything of one tile, in its thread's scratch ---- */
typedef struct {
    float *sampled;          /* [STRIP][3 D] */
    channels color;          /* encoded */
    channels token, x1;      /* 3 D: sampled; 2 D: after attention */
    channels normed0, qkv;   /* 3 tokens */
    channels chance;         /* [head][2][3] */
    channels mixed, normed1; /* 2 tokens */
    channels pre, gelu;      /* 2 tokens: before GELU and after */
    channels x, v, h[POINT_DECODER_MAX], views;
    /* gradients */
    channels drgb, dviews /* and the density's */, dh[2];
    channels dtoken, dnorm, dhidden, dmixed, dqkv;
    float *room; /* [POINT_TILE][STRIP] */
} space;

/* Allocates scratch from its start; without a base it only counts. */
typedef struct {
    float *base;
    size_t used;
} room;

static float *take(room *r, size_t floats) {
    float *p = r->base ? r->base + r->used : NULL;
    r->used += (floats + 15) / 16 * 16;
    return p;
}

/* Products read up to a block, and gradients up to a panel, past the last channel; those values are not used.
 */
static channels take_channels(room *r, int count) {
    const size_t pitch = ((size_t)count + STRIP) * STRIP;
    return (channels){take(r, STRIPS * pitch), pitch};
}

static void lay_out(const radiance_field *n, room *r, space *s) {
    const int width = n->s.token_width, all = n->attention_width, h = n->s.decoder_width,
              last = n->s.decoder_depth - 1;
    s->sampled = take(r, (size_t)STRIP * (size_t)n->fused);
    s->color = take_channels(r, n->color_width);
    s->token = take_channels(r, 3 * width);
    s->x1 = take_channels(r, 2 * width);
    s->normed0 = take_channels(r, 3 * width);
    s->qkv = take_channels(r, 9 * all);
    s->chance = take_channels(r, 6 * n->s.heads);
    s->mixed = take_channels(r, 2 * all);
    s->normed1 = take_channels(r, 2 * width);
    s->pre = take_channels(r, 2 * width);
    s->gelu = take_channels(r, 2 * width);
    s->x = take_channels(r, n->position_width + width + h);
    s->v = take_channels(r, h + n->direction_width + width);
    for (int i = 0; i <= last; i++)
        s->h[i] = i == last                ? s->v
                  : i == n->s.decoder_skip ? (channels){s->x.at, s->x.pitch}
                                           : take_channels(r, h);
    if (r->base && n->s.decoder_skip >= 0)
        s->h[n->s.decoder_skip] = from_channel(s->x, n->position_width + width);
    s->views = take_channels(r, n->s.view_width);
    s->drgb = take_channels(r, 3);
    s->dviews = take_channels(r, n->s.view_width + 1);
    for (int i = 0; i < 2; i++) s->dh[i] = take_channels(r, h);
    s->dtoken = take_channels(r, 3 * width);
    s->dnorm = take_channels(r, width);
    s->dhidden = take_channels(r, width);
    s->dmixed = take_channels(r, 2 * all);
    s->dqkv = take_channels(r, 9 * all);
    s->room = take(r, POINT_TILE * STRIP);
}

static size_t scratch_bytes(const radiance_trainer *t) {
    space s;
    room r = {0};
    lay_out(t->n, &r, &s);
    return r.used * sizeof(float);
}

/* ---- forward pass, keeping what the backward pass needs ---- */
/* Of one strip. */
static void encode(const float *const x[3], int frequencies, int width, vf *out) {
    for (int i = 0; i < 3; i++)
        for (int v = 0; v < VECTORS; v++)
            encode_component(((const vf *)x[i])[v], i, frequencies, width, out + v, VECTORS);
}

static void sample_strip(const radiance_field *n, const point_tile *t, int strip, const space *s) {
    float color[3][STRIP] __attribute__((aligned(64)));
    for (int p = 0; p < STRIP; p++) {
        float *row = s->sampled + (size_t)p * (size_t)n->fused, rgb[4] = {0};
        if (strip * STRIP + p < t->count)
            sample_point(n, t, strip * STRIP + p, row, rgb);
        else
            memset(row, 0, (size_t)n->fused * sizeof *row);
        for (int i = 0; i < 3; i++) color[i][p] = rgb[i];
    }
    transpose(s->sampled, STRIP, n->fused, (size_t)n->fused, (float *)row_of(s->token, strip, 0), STRIP);
    encode((const float *const[3]){color[0], color[1], color[2]}, n->s.color_frequencies, n->color_width,
           row_of(s->color, strip, 0));
}

static void norm(channels from, int width, const float *weight, const float *bias, channels to) {
    for (int s = 0; s < STRIPS; s++)
        for (int v = 0; v < VECTORS; v++)
            norm_vector(row_of(from, s, 0) + v, width, weight, bias, row_of(to, s, 0) + v, VECTORS);
}

/* Of one vector of points; chance [head][2][3]. */
static void attention(const radiance_field *n, const vf *qkv, vf *chance, vf *mixed) {
    const int head = n->s.head_width * VECTORS;
    for (int h = 0; h < n->s.heads; h++)
        attention_head(n, qkv + h * head, chance + h * 6 * VECTORS, mixed + h * head, VECTORS);
}

static void gelu(channels x, int width, channels y) {
    for (int s = 0; s < STRIPS; s++)
        for (int i = 0; i < width * VECTORS; i++) row_of(y, s, 0)[i] = gelu_lanes(row_of(x, s, 0)[i]);
}

static void transformer(const float_trainer *r, const space *s) {
    const radiance_field *n = r->base.n;
    const int width = n->s.token_width, all = n->attention_width;
    const channels out[2] = {from_channel(s->x, n->position_width),
                             from_channel(s->v, n->s.decoder_width + n->direction_width)};
    for (int i = 0; i < 3; i++) {
        const channels normed = from_channel(s->normed0, i * width);
        norm(from_channel(s->token, i * width), width, n->norm0_w, n->norm0_b, normed);
        product(&r->qkv, i < 2 ? 0 : all, 0, normed, from_channel(s->qkv, i * 3 * all));
    }
    for (int k = 0; k < STRIPS; k++)
        for (int v = 0; v < VECTORS; v++)
            attention(n, row_of(s->qkv, k, 0) + v, row_of(s->chance, k, 0) + v, row_of(s->mixed, k, 0) + v);
    for (int i = 0; i < 2; i++) {
        const channels x1 = from_channel(s->x1, i * width), normed = from_channel(s->normed1, i * width),
                       pre = from_channel(s->pre, i * width), hidden = from_channel(s->gelu, i * width);
        product_added(&r->attention_out, from_channel(s->mixed, i * all), x1,
                      from_channel(s->token, i * width));
        norm(x1, width, n->norm1_w, n->norm1_b, normed);
        product(&r->mlp0, 0, 0, normed, pre);
        gelu(pre, width, hidden);
        product_added(&r->mlp1, hidden, out[i], x1);
    }
}

static void forward(const float_trainer *r, const point_tile *t, const space *s) {
    const radiance_field *n = r->base.n;
    const channels color = from_channel(s->token, n->color_token * n->s.token_width);
    for (int k = 0; k < STRIPS; k++) {
        const float *at[3], *along[3];
        for (int i = 0; i < 3; i++) {
            at[i] = t->position[i] + k * STRIP;
            along[i] = t->direction[i] + k * STRIP;
        }
        sample_strip(n, t, k, s);
        encode(at, n->s.position_frequencies, n->position_width, row_of(s->x, k, 0));
        encode(along, n->s.direction_frequencies, n->direction_width, row_of(s->v, k, n->s.decoder_width));
    }
    if (n->color_width) product_added(&r->color, s->color, color, color);
    transformer(r, s);
    channels in = s->x;
    for (int i = 0; i < n->s.decoder_depth; i++) {
        product_relu(&r->pts[i], in, s->h[i]);
        in = i == n->s.decoder_skip ? s->x : s->h[i];
    }
    product_relu(&r->views, s->v, s->views);
}

/* ---- backwards ---- */
static void decoder_back(const float_trainer *r, const float *const dout[4], const space *s, float *lane) {
    const radiance_field *n = r->base.n;
    const int last = n->s.decoder_depth - 1, skip = n->s.decoder_skip;
    for (int k = 0; k < STRIPS; k++) {
        for (int i = 0; i < 3; i++) memcpy(row_of(s->drgb, k, i), dout[i] + k * STRIP, STRIP * sizeof(float));
        memcpy(row_of(s->dviews, k, n->s.view_width), dout[3] + k * STRIP, STRIP * sizeof(float));
    }
    add_gradient(&r->base.sum.rgb, 0, s->drgb, s->views, lane, s->room);
    product_masked(&r->back.rgb, s->drgb, s->dviews, s->views);
    add_gradient(&r->base.sum.views, 0, s->dviews, s->v, lane, s->room);
    product(&r->back.token1, 0, 0, s->dviews, from_channel(s->dtoken, n->s.token_width));
    product_masked(&r->back.views, s->dviews, s->dh[0], s->h[last]);
    for (int i = last; i >= 0; i--) {
        const channels dh = s->dh[(last - i) & 1], in = i == 0 || i - 1 == skip ? s->x : s->h[i - 1];
        add_gradient(&r->base.sum.pts[i], 0, dh, in, lane, s->room);
        if (i - 1 == skip) product(&r->back.skip_token0, 0, 0, dh, s->dtoken);
        if (i > 0)
            product_masked(&r->back.pts[i], dh, s->dh[(last - i + 1) & 1], s->h[i - 1]);
        else if (skip >= 0)
            product_added(&r->back.token0, dh, s->dtoken, s->dtoken);
        else
            product(&r->back.token0, 0, 0, dh, s->dtoken);
    }
}

/* Backward through a layer norm: dx += its part; sums of the weight's and the bias's gradients. */
static void norm_back(channels from, channels dy, int width, const float *weight, channels dx, float *dweight,
                      float *dbias) {
    for (int s = 0; s < STRIPS; s++)
        for (int v = 0; v < VECTORS; v++) {
            const vf *x = row_of(from, s, 0) + v, *d = row_of(dy, s, 0) + v;
            vf *to = row_of(dx, s, 0) + v, share = splat(0), along = splat(0);
            const moments stats = moments_of(x, width, VECTORS);
            for (int i = 0; i < width; i++) {
                const vf unit = (x[i * VECTORS] - stats.mean) * stats.scale, du = d[i * VECTORS] * weight[i];
                share += du;
                along += du * unit;
                ((vf *)dweight)[i] += d[i * VECTORS] * unit;
                ((vf *)dbias)[i] += d[i * VECTORS];
            }
            share /= (float)width;
            along /= (float)width;
            for (int i = 0; i < width; i++) {
                const vf unit = (x[i * VECTORS] - stats.mean) * stats.scale;
                to[i * VECTORS] += (d[i * VECTORS] * weight[i] - share - unit * along) * stats.scale;
            }
        }
}

/* For one vector of points: the gradients of the attention's results -> those of qkv. Token 2 has no query.
 */
static void attention_back(const radiance_field *n, const vf *qkv, const vf *chance, const vf *dmixed,
                           vf *dqkv) {
    const int head = n->s.head_width, all = n->attention_width, token = 3 * all * VECTORS,
              part = all * VECTORS;
    const float scale = 1.0f / sqrtf((float)head);
    for (int h = 0; h < n->s.heads; h++) {
        vf p[2][3], e[2][3];
        for (int i = 0; i < 2; i++)
            for (int j = 0; j < 3; j++) {
                p[i][j] = chance[((h * 2 + i) * 3 + j) * VECTORS];
                e[i][j] = splat(0);
            }
        for (int d = h * head * VECTORS; d < (h + 1) * head * VECTORS; d += VECTORS)
            for (int j = 0; j < 3; j++) {
                const vf value = qkv[j * token + 2 * part + d];
                for (int i = 0; i < 2; i++) e[i][j] += dmixed[i * part + d] * value;
                dqkv[j * token + 2 * part + d] = p[0][j] * dmixed[d] + p[1][j] * dmixed[part + d];
            }
        for (int i = 0; i < 2; i++) { /* through softmax and scale */
            const vf mean = p[i][0] * e[i][0] + p[i][1] * e[i][1] + p[i][2] * e[i][2];
            for (int j = 0; j < 3; j++) e[i][j] = p[i][j] * (e[i][j] - mean) * scale;
        }
        for (int d = h * head * VECTORS; d < (h + 1) * head * VECTORS; d += VECTORS) {
            for (int i = 0; i < 2; i++)
                dqkv[i * token + d] = e[i][0] * qkv[part + d] + e[i][1] * qkv[token + part + d] +
                                      e[i][2] * qkv[2 * token + part + d];
            for (int j = 0; j < 3; j++)
                dqkv[j * token + part + d] = e[0][j] * qkv[d] + e[1][j] * qkv[token + d];
        }
    }
}

static void gelu_back(channels x, int width, channels d) {
    for (int s = 0; s < STRIPS; s++)
        for (int i = 0; i < width * VECTORS; i++) row_of(d, s, 0)[i] *= gelu_slope_lanes(row_of(x, s, 0)[i]);
}

/* dtoken: in, of the transformer's result (tokens 0 and 1); out, of the sampled values. */
static void transformer_back(const float_trainer *r, const space *s, float *lane) {
    const radiance_field *n = r->base.n;
    const int width = n->s.token_width, all = n->attention_width;
    for (int i = 0; i < 2; i++) {
        const channels d = from_channel(s->dtoken, i * width);
        add_gradient(&r->base.sum.mlp1, 0, d, from_channel(s->gelu, i * width), lane, s->room);
        product(&r->back.mlp1, 0, 0, d, s->dhidden);
        gelu_back(from_channel(s->pre, i * width), width, s->dhidden);
        add_gradient(&r->base.sum.mlp0, 0, s->dhidden, from_channel(s->normed1, i * width), lane, s->room);
        product(&r->back.mlp0, 0, 0, s->dhidden, s->dnorm);
        norm_back(from_channel(s->x1, i * width), s->dnorm, width, n->norm1_w, d, lane + r->base.norm1_w,
                  lane + r->base.norm1_b);
        add_gradient(&r->base.sum.attention_out, 0, d, from_channel(s->mixed, i * all), lane, s->room);
        product(&r->back.attention_out, 0, 0, d, from_channel(s->dmixed, i * all));
    }
    for (int k = 0; k < STRIPS; k++) {
        for (int v = 0; v < VECTORS; v++)
            attention_back(n, row_of(s->qkv, k, 0) + v, row_of(s->chance, k, 0) + v,
                           row_of(s->dmixed, k, 0) + v, row_of(s->dqkv, k, 0) + v);
        memset(row_of(s->dtoken, k, 2 * width), 0, (size_t)width * STRIP * sizeof(float));
    }
    for (int i = 0; i < 3; i++) { /* the third's queries stay 0, their initial value */
        const int first = i < 2 ? 0 : all;
        const channels d = from_channel(s->dqkv, i * 3 * all);
        add_gradient(&r->base.sum.qkv, first, d, from_channel(s->normed0, i * width), lane, s->room);
        product(&r->back.qkv, 0, first, d, s->dnorm);
        norm_back(from_channel(s->token, i * width), s->dnorm, width, n->norm0_w,
                  from_channel(s->dtoken, i * width), lane + r->base.norm0_w, lane + r->base.norm0_b);
    }
}

/* The sampled tokens' gradients: biases, the colour's layer, and as rows of points. */
static void sampled_back(const float_trainer *r, const space *s, int count, float *dtoken, float *lane) {
    const radiance_field *n = r->base.n;
    const size_t fused = (size_t)n->fused;
    add_sums(s->dtoken, n->fused, lane + r->base.token_b);
    if (n->color_width)
        add_gradient(&r->base.sum.color, 0, from_channel(s->dtoken, n->color_token * n->s.token_width),
                     s->color, lane, s->room);
    for (int k = 0; k < STRIPS && k * STRIP < count; k++) {
        const int left = count - k * STRIP;
        transpose((const float *)row_of(s->dtoken, k, 0), n->fused, STRIP, STRIP, s->sampled, fused);
        memcpy(dtoken + (size_t)(k * STRIP) * fused, s->sampled,
               (size_t)(left < STRIP ? left : STRIP) * fused * sizeof(float));
    }
}

/* The scratch starts as zeros: values that no pass writes (padding, the third token's queries) stay 0. */
static void tile(const radiance_trainer *base, train_tile *t, float *lane, void *scratch) {
    const float_trainer *r = (const float_trainer *)base;
    space s;
    lay_out(r->base.n, &(room){.base = scratch}, &s);
    for (int k = 0; k < TRAIN_PARTS && t->part[k].count > 0; k++) {
        const int at = k * POINT_TILE;
        forward(r, &t->part[k], &s);
        decoder_back(
            r, (const float *const[4]){t->dout[0] + at, t->dout[1] + at, t->dout[2] + at, t->dout[3] + at},
            &s, lane);
        transformer_back(r, &s, lane);
        sampled_back(r, &s, t->part[k].count, t->dtoken + (size_t)at * (size_t)r->base.n->fused, lane);
    }
}

/* ---- the bank ---- */
INLINE void scatter_taps(const tap *taps, int count, const float *base, const float *d, int width,
                         float *out) {
    for (int k = 0; k < count; k++) {
        float *row = out + (taps[k].row - base);
        for (int c = 0; c < width; c += LANES)
            *(vf_any *)(row + c) += *(const vf_any *)(d + c) * taps[k].weight;
    }
}

static void scatter_level(const radiance_field *n, const radiance_level *l, const point_set *points,
                          const int32_t *index, int64_t count, const float *d, float *out) {
    const float *base = l->value + l->stride; /* row 0 belongs to no voxel */
    for (int64_t i = 0; i < count; i++, d += n->fused) {
        const float *x = points->canonical + 3 * (int64_t)index[i];
        tap taps[8];
        const int k = trilinear_taps(
            l, (float[]){x[0] - n->volume_min[0], x[1] - n->volume_min[1], x[2] - n->volume_min[2]}, taps);
        scatter_taps(taps, k, base, d, n->fused, out);
    }
}

static void scatter_plane(const radiance_field *n, int plane, const point_set *points, const int32_t *index,
                          int64_t count, const float *d, float *out) {
    const radiance_map *map = &n->plane[plane];
    for (int64_t i = 0; i < count; i++, d += n->fused) {
        const float *x = points->canonical + 3 * (int64_t)index[i];
        float texel[3];
        tap taps[4];
        for (int k = 0; k < 3; k++) texel[k] = (x[k] - n->plane_min[k]) * n->plane_scale[k] - 0.5f;
        const int k = bilinear_taps(map->texel, map->width, map->height, map->stride,
                                    texel[plane_axis[plane][0]], texel[plane_axis[plane][1]], taps);
        scatter_taps(taps, k, map->texel, d + plane * n->s.token_width, n->s.token_width, out);
    }
}

static void scatter_map(const radiance_field *n, const point_set *points, const int32_t *index, int64_t count,
                        const float *d, float *out) {
    const radiance_map *map = &n->map;
    for (int64_t i = 0; i < count; i++, d += n->fused) {
        const float *px = points->observed_px + 2 * (int64_t)index[i];
        tap taps[4];
        const int k = bilinear_taps(map->texel, map->width, map->height, map->stride, px[0] * n->map_scale[0],
                                    px[1] * n->map_scale[1], taps);
        scatter_taps(taps, k, map->texel, d, n->map_tokens * n->s.token_width, out);
    }
}

/* Starts with the longest. */
static void scatter(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                    int64_t count, const float *dtoken, const radiance_gradients *out) {
    if (job < POINT_LEVELS)
        scatter_level(n, &n->level[job], points, index, count, dtoken, out->level[job]);
    else if (job == POINT_LEVELS)
        scatter_map(n, points, index, count, dtoken, out->map);
    else
        scatter_plane(n, job - POINT_LEVELS - 1, points, index, count, dtoken,
                      out->plane[job - POINT_LEVELS - 1]);
}

const train_float_kernels KERNELS = {ROWS, STRIP, LANES, scratch_bytes, tile, scatter};
