/* Gradients of the radiance field's weights from the groups' records: dW = dY^T X over points. A warp has up
 * to 2 x 4 tiles of a matrix and a slab of the chunk's groups. The records hold fragments in the layout of
 * the tensor cores, so nothing passes through shared memory. Rows' sums, for biases, are products with ones.
 * Each slab's sums stay separate until all chunks are done, and are added in order. */
#include "model/sherf/cuda/train.h"

namespace cuda_backend {

enum { UNIT_ROWS = 2, UNIT_COLUMNS = 4 };

/* ---- where sums and tiles are ---- */
static matrix_sums sums_place(int row_tiles, int column_tiles, int64_t *at) {
    const matrix_sums m = {row_tiles, column_tiles, *at, *at + 256 * (int64_t)row_tiles * column_tiles};
    *at = m.b + 16 * row_tiles;
    return m;
}

void train_sums_plan(const network_sizes &s, int H, record_places *r, all_sums *out) {
    const int depth = s.decoder_depth;
    int tiles = 0;
    const auto take = [&tiles](int count) { return (tiles += count) - count; };
    r->x = take(X_TILES), r->h = take(depth * H), r->direction = take(DIRECTION_TILES);
    r->token1 = take(TOKEN_TILES), r->shown = take(VIEW_TILES);
    r->dh = take(depth * H), r->dviews = take(VIEW_TILES), r->dout = take(1), r->dalpha = take(1);
    r->color = take(COLOR_TILES), r->n0 = take(3 * TOKEN_TILES), r->mixed = take(2 * s.heads);
    r->n1 = take(2 * TOKEN_TILES), r->gelu = take(2 * TOKEN_TILES), r->dcolor = take(TOKEN_TILES);
    r->dqkv = take(9 * s.heads), r->dattended = take(2 * TOKEN_TILES);
    r->dpre = take(2 * TOKEN_TILES), r->dlast = take(2 * TOKEN_TILES);
    r->tiles = tiles;
    *out = {};
    int64_t at = 0;
    for (int i = 0; i < depth; i++)
        out->pts[i] = sums_place(H, i == 0 ? X_TILES : i == s.decoder_skip + 1 ? X_TILES + H : H, &at);
    out->views = sums_place(VIEW_TILES, H + DIRECTION_TILES + TOKEN_TILES, &at);
    out->alpha = sums_place(1, H, &at);
    out->rgb = sums_place(1, VIEW_TILES, &at);
    if (s.color_width) out->color = sums_place(TOKEN_TILES, COLOR_TILES, &at);
    out->qkv = sums_place(3 * s.heads, TOKEN_TILES, &at);
    out->attention_out = sums_place(TOKEN_TILES, s.heads, &at);
    out->mlp0 = sums_place(TOKEN_TILES, TOKEN_TILES, &at);
    out->mlp1 = sums_place(TOKEN_TILES, TOKEN_TILES, &at);
    out->floats = at;
}

struct units_list {
    sums_unit *unit;
    int count;
    /* Column tiles [first, first + columns) of m from the record's tiles x ...; tokens: the distance of both
     * between tokens. */
    void add(const matrix_sums &m, int dy, int x, int first, int columns, int tokens = 1, int dy_step = 0,
             int x_step = 0) {
        const int pitch = 16 * m.column_tiles;
        for (int i = 0; i < m.row_tiles; i += UNIT_ROWS)
            for (int k = 0; k < columns; k += UNIT_COLUMNS, count++) {
                if (!unit) continue;
                unit[count] = {dy + i,
                               x + k,
                               m.row_tiles - i < UNIT_ROWS ? m.row_tiles - i : UNIT_ROWS,
                               columns - k < UNIT_COLUMNS ? columns - k : UNIT_COLUMNS,
                               tokens,
                               dy_step,
                               x_step,
                               pitch,
                               m.w + (int64_t)16 * i * pitch + 16 * (first + k),
                               first + k == 0 ? m.b + 16 * i : -1};
            }
    }
};

int train_units(const network_sizes &s, int H, const record_places &r, const all_sums &m, sums_unit *unit) {
    units_list l = {unit, 0};
    for (int i = 0; i < s.decoder_depth; i++) {
        const int dy = r.dh + i * H, wide = i > 0 && i == s.decoder_skip + 1;
        if (i == 0 || wide) l.add(m.pts[i], dy, r.x, 0, X_TILES);
        if (i > 0) l.add(m.pts[i], dy, r.h + (i - 1) * H, wide ? X_TILES : 0, H);
    }
    l.add(m.views, r.dviews, r.h + (s.decoder_depth - 1) * H, 0, H);
    l.add(m.views, r.dviews, r.direction, H, DIRECTION_TILES);
    l.add(m.views, r.dviews, r.token1, H + DIRECTION_TILES, TOKEN_TILES);
    l.add(m.alpha, r.dalpha, r.h + (s.decoder_depth - 1) * H, 0, H);
    l.add(m.rgb, r.dout, r.shown, 0, VIEW_TILES);
    if (s.color_width) l.add(m.color, r.dcolor, r.color, 0, COLOR_TILES);
    l.add(m.qkv, r.dqkv, r.n0, 0, TOKEN_TILES, 3, 3 * s.heads, TOKEN_TILES);
    l.add(m.attention_out, r.dattended, r.mixed, 0, s.heads, 2, TOKEN_TILES, s.heads);
    l.add(m.mlp0, r.dpre, r.n1, 0, TOKEN_TILES, 2, TOKEN_TILES, TOKEN_TILES);
    l.add(m.mlp1, r.dlast, r.gelu, 0, TOKEN_TILES, 2, TOKEN_TILES, TOKEN_TILES);
    return l.count;
}

/* ---- the products ---- */
/* Block (x, y): the eight units from 8 x on, slab y. */
static __global__ void __launch_bounds__(THREADS)
    weights_kernel(train_run r, const sums_unit *unit, int units, int64_t floats, float *partial) {
    const int lane = (int)threadIdx.x % WARP, which = (int)blockIdx.x * WARPS + (int)threadIdx.x / WARP;
    const int64_t end = chunk_points(r);
    if (which >= units || end <= 0) return;
    const sums_unit u = unit[which];
    const int64_t groups = (end + TILE_POINTS - 1) / TILE_POINTS;
    const int64_t begin = groups * blockIdx.y / SLABS, last = groups * (blockIdx.y + 1) / SLABS;
    const uint32_t ones[2] = {0x3f803f80u, 0x3f803f80u};
    sums acc[UNIT_ROWS][2 * UNIT_COLUMNS] = {}, row[UNIT_ROWS] = {};
    for (int64_t group = begin; group < last; group++)
        for (int token = 0; token < u.tokens; token++) {
            const uint4 *from = r.records + group * r.at.tiles * WARP + lane;
            const uint4 *dy = from + (u.dy + token * u.dy_step) * WARP,
                        *x = from + (u.x + token * u.x_step) * WARP;
            uint32_t a[UNIT_ROWS][4];
            UNROLL
            for (int i = 0; i < UNIT_ROWS; i++) {
                const uint4 v = dy[(i < u.rows ? i : 0) * WARP];
                a[i][0] = v.x, a[i][1] = v.y, a[i][2] = v.z, a[i][3] = v.w;
            }
            UNROLL
            for (int k = 0; k < UNIT_COLUMNS; k++) {
                if (k >= u.columns) continue;
                const uint4 v = x[k * WARP];
                const uint32_t low[2] = {v.x, v.z}, high[2] = {v.y, v.w};
                UNROLL
                for (int i = 0; i < UNIT_ROWS; i++) {
                    mma_bf16(acc[i][2 * k].c, a[i], low);
                    mma_bf16(acc[i][2 * k + 1].c, a[i], high);
                }
            }
            if (u.b < 0) continue;
            UNROLL
            for (int i = 0; i < UNIT_ROWS; i++) mma_bf16(row[i].c, a[i], ones);
        }
    float *to = partial + blockIdx.y * floats;
    const int g = lane / 4, t = lane % 4;
    UNROLL
    for (int i = 0; i < UNIT_ROWS; i++) {
        if (i >= u.rows) continue;
        UNROLL
        for (int n = 0; n < 2 * UNIT_COLUMNS; n++) {
            if (n >= 2 * u.columns) continue;
            for (int e = 0; e < 4; e++)
                to[u.w + (16 * i + g + e / 2 * 8) * u.pitch + 8 * n + 2 * t + e % 2] += acc[i][n].c[e];
        }
        for (int half = 0; half < 2 && u.b >= 0 && t == 0; half++)
            to[u.b + 16 * i + g + 8 * half] += row[i].c[2 * half];
    }
}

void train_weights(const train_network *n, const train_run &r, float *partial) {
    launch(weights_kernel, dim3((unsigned)divided_up(n->units, WARPS), SLABS), dim3(THREADS), r, n->unit,
           n->units, n->sums.floats, partial);
}

/* ---- from sums to the checkpoints' weights ---- */
struct summed {
    const float *w, *b;
    int pitch;
    __device__ float at(int row, int column) const { return w[(int64_t)row * pitch + column]; }
    /* For a value of an encoding; the low parts of its first three follow it. */
    __device__ float encoded(int row, int first, int column, int width) const {
        return at(row, first + column) + (column < 3 ? at(row, first + width + column) : 0);
    }
};

/* to[row][column] += value(row, column) */
template <typename F> static void add_matrix(float *to, int rows, int columns, F value) {
    each((int64_t)rows * columns,
         [=] __device__(int64_t i) { to[i] += value((int)(i / columns), (int)(i % columns)); });
}

static void add_vector(float *to, const float *from, int count) {
    each(count, [=] __device__(int64_t i) { to[i] += from[i]; });
}

#define GRAD(p) (out->grads + ((p)-out->values))

static void unpack_fusion(const train_network *n, const summed &qkv, const summed &attention,
                          const summed &mlp0, const summed &mlp1, const float *vector,
                          const radiance_gradients *out) {
    const radiance_weights &w = n->w;
    const int width = n->s.head_width, all = n->s.all, heads = n->s.heads;
    const float scale = 1.44269504f / sqrtf((float)width);
    add_matrix(GRAD(w.qkv_w), 3 * all, TOKEN, [=] __device__(int row, int k) {
        const int part = row / all, head = row % all / width;
        return qkv.at(16 * (part * heads + head) + row % width, k) * (part == 0 ? scale : 1);
    });
    add_matrix(GRAD(w.attention_out_w), TOKEN, all,
               [=] __device__(int row, int k) { return attention.at(row, k / width * 16 + k % width); });
    add_matrix(GRAD(w.mlp0_w), TOKEN, TOKEN, [=] __device__(int row, int k) { return mlp0.at(row, k); });
    add_matrix(GRAD(w.mlp1_w), TOKEN, TOKEN, [=] __device__(int row, int k) { return mlp1.at(row, k); });
    add_vector(GRAD(w.attention_out_b), attention.b, TOKEN);
    add_vector(GRAD(w.mlp0_b), mlp0.b, TOKEN);
    add_vector(GRAD(w.mlp1_b), mlp1.b, TOKEN);
    add_vector(GRAD(w.norm0_w), vector + NORM0_W * TOKEN, TOKEN);
    add_vector(GRAD(w.norm0_b), vector + NORM0_B * TOKEN, TOKEN);
    add_vector(GRAD(w.norm1_w), vector + NORM1_W * TOKEN, TOKEN);
    add_vector(GRAD(w.norm1_b), vector + NORM1_B * TOKEN, TOKEN);
}

/* Colour's columns of the token projection, and the biases: token i has b + W_v b_volume[i]. d: of the
 * tokens' biases, [3][TOKEN]. */
static void unpack_tokens(const train_network *n, const summed &color, const float *d,
                          const radiance_gradients *out) {
    const float *tw = n->w.token_projection_w, *vb = n->w.volume_projection_b;
    float *dw = GRAD(tw), *db = GRAD(n->w.token_projection_b), *dv = GRAD(vb);
    const int color_width = n->s.color_width, first = TOKEN + n->feature_channels % TOKEN;
    if (color_width)
        each(TOKEN * color_width, [=] __device__(int64_t i) {
            const int row = (int)(i / color_width), q = (int)(i % color_width);
            dw[(int64_t)row * TOKENS + first + q] += color.at(row, q);
        });
    each(TOKEN * TOKEN, [=] __device__(int64_t i) {
        const int row = (int)(i / TOKEN), j = (int)(i % TOKEN);
        float sum = 0;
        for (int k = 0; k < 3; k++) sum += d[k * TOKEN + row] * vb[k * TOKEN + j];
        dw[(int64_t)row * TOKENS + 2 * TOKEN + j] += sum;
    });
    each(TOKEN, [=] __device__(int64_t row) { db[row] += d[row] + d[TOKEN + row] + d[2 * TOKEN + row]; });
    each(TOKENS, [=] __device__(int64_t i) {
        float sum = 0;
        for (int row = 0; row < TOKEN; row++)
            sum += d[i / TOKEN * TOKEN + row] * tw[(int64_t)row * TOKENS + 2 * TOKEN + i % TOKEN];
        dv[i] += sum;
    });
}

/* The merged layer M = V F, bias V b_F + b_V; and V's other columns. */
static void unpack_views(const train_network *n, const summed &views, const radiance_gradients *out) {
    const network_sizes s = n->s;
    const int h = s.decoder_width, columns = h + s.direction_width + TOKEN, rows = s.view_width,
              H = 16 * n->h_tiles;
    const float *v = n->w.views_w, *f = n->w.feature_w, *bf = n->w.feature_b;
    add_matrix(GRAD(v), rows, columns, [=] __device__(int o, int k) {
        if (k >= h + s.direction_width)
            return views.at(o, H + 16 * DIRECTION_TILES + k - h - s.direction_width);
        if (k >= h) return views.encoded(o, H, k - h, s.direction_width);
        float sum = views.b[o] * bf[k];
        for (int j = 0; j < h; j++) sum += views.at(o, j) * f[(int64_t)k * h + j];
        return sum;
    });
    add_matrix(GRAD(f), h, h, [=] __device__(int row, int k) {
        float sum = 0;
        for (int o = 0; o < rows; o++) sum += v[(int64_t)o * columns + row] * views.at(o, k);
        return sum;
    });
    add_matrix(GRAD(bf), 1, h, [=] __device__(int, int k) {
        float sum = 0;
        for (int o = 0; o < rows; o++) sum += v[(int64_t)o * columns + k] * views.b[o];
        return sum;
    });
    add_vector(GRAD(n->w.views_b), views.b, rows);
}

static void unpack_layer(const train_network *n, int layer, const summed &m, const radiance_gradients *out) {
    const network_sizes s = n->s;
    const bool first = layer == 0, wide = !first && layer == s.decoder_skip + 1;
    const int h = s.decoder_width, x = s.position_width + TOKEN;
    add_matrix(GRAD(n->w.pts_w[layer]), h,
               first  ? x
               : wide ? x + h
                      : h,
               [=] __device__(int row, int k) {
                   if (!first && !wide) return m.at(row, k);
                   if (k < s.position_width) return m.encoded(row, 0, k, s.position_width);
                   return m.at(row, k < x ? 16 * PLACE_TILES + k - s.position_width : 16 * X_TILES + k - x);
               });
    add_vector(GRAD(n->w.pts_b[layer]), m.b, h);
}

/* Sums each block's lanes into [VECTORS][TOKEN]. */
static void sum_vectors(const float *lanes, float *vector) {
    each_row(VECTORS * TOKEN, [=] __device__(int64_t i, int lane) {
        const int which = (int)(i / TOKEN), channel = (int)(i % TOKEN), t = channel % 8 / 2;
        const int slot = which * 8 + channel / 8 * 2 + channel % 2;
        float sum = 0;
        for (int k = lane; k < FUSION_BLOCKS * WARPS * 8; k += WARP) {
            const int block = k / (WARPS * 8), thread = k % (WARPS * 8) * 4 + t;
            sum += lanes[((int64_t)block * VECTOR_SLOTS + slot) * THREADS + thread];
        }
        sum = warp_sum(sum);
        if (lane == 0) vector[i] = sum;
    });
}

void train_unpack(const train_network *n, const float *partial, const float *vectors, float *total,
                  float *vector, const radiance_gradients *out) {
    const int64_t floats = n->sums.floats;
    each(floats, [=] __device__(int64_t i) {
        float sum = 0;
        for (int slab = 0; slab < SLABS; slab++) sum += partial[slab * floats + i];
        total[i] = sum;
    });
    sum_vectors(vectors, vector);
    const auto of = [total](const matrix_sums &m) {
        return summed{total + m.w, total + m.b, 16 * m.column_tiles};
    };
    const all_sums &m = n->sums;
    for (int i = 0; i < n->s.decoder_depth; i++) unpack_layer(n, i, of(m.pts[i]), out);
    unpack_views(n, of(m.views), out);
    const summed alpha = of(m.alpha), rgb = of(m.rgb);
    add_matrix(GRAD(n->w.alpha_w), 1, n->s.decoder_width,
               [=] __device__(int, int k) { return alpha.at(0, k); });
    add_vector(GRAD(n->w.alpha_b), alpha.b, 1);
    add_matrix(GRAD(n->w.rgb_w), 3, n->s.view_width,
               [=] __device__(int row, int k) { return rgb.at(row, k); });
    add_vector(GRAD(n->w.rgb_b), rgb.b, 3);
    unpack_fusion(n, of(m.qkv), of(m.attention_out), of(m.mlp0), of(m.mlp1), vector, out);
    unpack_tokens(n, of(m.color), vector + TOKEN_B * TOKEN, out);
}

#undef GRAD

} // namespace cuda_backend
