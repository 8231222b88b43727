/* The radiance field in float32: for comparison with the bf16 kernel, and for sizes that it does not support.
 * A block takes 32 points at a time, one for each lane; its eight warps share the rows of a layer.
 * Activations are [channel][32 points] in the block's own memory, which stays in its L1 cache. */
#include "model/sherf/cuda/network.h"

namespace cuda_backend {

enum { WARPS = ROWS_A_BLOCK, ROWS = 4 };

struct float_places { /* rows of each buffer's first channel */
    int token, normed, qkv, mixed, hidden, color, x, v, a, b, rows;
};

static __host__ __device__ float_places float_layout(const network_sizes &s) {
    const int widest = s.decoder_width > s.view_width ? s.decoder_width : s.view_width;
    float_places p;
    int at = 0;
    p.token = at, at += s.fused;
    p.normed = at, at += s.fused;
    p.qkv = at, at += 9 * s.all;
    p.mixed = at, at += 2 * s.all;
    p.hidden = at, at += 2 * s.width;
    p.color = at, at += s.color_width + 6;
    p.x = at, at += s.position_width + s.width + s.decoder_width;
    p.v = at, at += s.decoder_width + s.direction_width + s.width;
    p.a = at, at += widest;
    p.b = at, at += widest + 4;
    p.rows = at;
    return p;
}

int64_t float_rows(const network_sizes *s) {
    return float_layout(*s).rows;
}

int float_blocks() {
    return 2 * multiprocessors();
}

struct float_tile {
    float *space;
    int lane, warp;
    __device__ float &at(int row) const { return space[row * WARP + lane]; }

    /* y = m x, rows [from, m.rows): row `from` of m is written to row y. */
    __device__ void product(const radiance_matrix &m, int x, int y, bool relu, int from = 0) const {
        for (int r = from + ROWS * warp; r < m.rows; r += ROWS * WARPS) {
            const float *w[ROWS];
            float sum[ROWS];
            UNROLL
            for (int j = 0; j < ROWS; j++) {
                const int row = r + j < m.rows ? r + j : m.rows - 1;
                w[j] = m.w + (int64_t)row * m.columns;
                sum[j] = m.b[row];
            }
            for (int k = 0; k < m.columns; k++) {
                const float v = at(x + k);
                UNROLL
                for (int j = 0; j < ROWS; j++) sum[j] += w[j][k] * v;
            }
            UNROLL
            for (int j = 0; j < ROWS; j++)
                if (r + j < m.rows) at(y + r + j - from) = relu ? fmaxf(sum[j], 0) : sum[j];
        }
    }

    /* x, then sin(2^k x), cos(2^k x) over the three components; rows beyond `width` are dropped. */
    __device__ void encode(const float *x, int frequencies, int width, int to) const {
        for (int i = warp; i < 3 * (frequencies + 1); i += WARPS) {
            const int k = i / 3 - 1, component = i % 3;
            if (k < 0) {
                if (component < width) at(to + component) = x[component];
                continue;
            }
            const int sine = 3 + 6 * k + component;
            const float angle = x[component] * (float)(1 << k);
            if (sine < width) at(to + sine) = sinf(angle);
            if (sine + 3 < width) at(to + sine + 3) = cosf(angle);
        }
    }

    __device__ void norm(int x, int width, const float *w, const float *b, int y) const {
        float mean = 0, variance = 0;
        for (int i = 0; i < width; i++) mean += at(x + i);
        mean /= (float)width;
        for (int i = 0; i < width; i++) variance += (at(x + i) - mean) * (at(x + i) - mean);
        const float scale = 1.0f / sqrtf(variance / (float)width + 1e-5f);
        for (int i = 0; i < width; i++) at(y + i) = (at(x + i) - mean) * scale * w[i] + b[i];
    }

    /* One head, of tokens 0 and 1: the decoder reads no other. */
    __device__ void attend(const network_sizes &s, const float_places &p, int head) const {
        const int token = 3 * s.all, first = p.qkv + head * s.head_width;
        const float scale = 1.0f / sqrtf((float)s.head_width);
        for (int i = 0; i < 2; i++) {
            float dot[3] = {0, 0, 0}, sum = 0;
            for (int d = 0; d < s.head_width; d++)
                for (int j = 0; j < 3; j++)
                    dot[j] += at(first + i * token + d) * at(first + j * token + s.all + d);
            const float top = fmaxf(fmaxf(dot[0], dot[1]), dot[2]);
            for (int j = 0; j < 3; j++) sum += dot[j] = expf((dot[j] - top) * scale);
            for (int d = 0; d < s.head_width; d++) {
                float mixed = 0;
                for (int j = 0; j < 3; j++) mixed += dot[j] / sum * at(first + j * token + 2 * s.all + d);
                at(p.mixed + i * s.all + head * s.head_width + d) = mixed;
            }
        }
    }

    __device__ void transform(const network_sizes &s, const float_layers &l, const float_places &p) const {
        for (int i = warp; i < 3; i += WARPS)
            norm(p.token + i * s.width, s.width, l.norm0_w, l.norm0_b, p.normed + i * s.width);
        __syncthreads();
        for (int i = 0; i < 3; i++) product(l.m.qkv, p.normed + i * s.width, p.qkv + 3 * i * s.all, false);
        __syncthreads();
        for (int head = warp; head < s.heads; head += WARPS) attend(s, p, head);
        __syncthreads();
        for (int i = 0; i < 2; i++)
            product(l.m.attention_out, p.mixed + i * s.all, p.normed + i * s.width, false);
        __syncthreads();
        for (int k = warp; k < 2 * s.width; k += WARPS) at(p.token + k) += at(p.normed + k);
        __syncthreads();
        for (int i = warp; i < 2; i += WARPS)
            norm(p.token + i * s.width, s.width, l.norm1_w, l.norm1_b, p.normed + i * s.width);
        __syncthreads();
        for (int i = 0; i < 2; i++) product(l.m.mlp0, p.normed + i * s.width, p.hidden + i * s.width, false);
        __syncthreads();
        for (int k = warp; k < 2 * s.width; k += WARPS) {
            const float x = at(p.hidden + k);
            at(p.hidden + k) = 0.5f * x * (1.0f + erff(x * 0.707106781f));
        }
        __syncthreads();
        for (int i = 0; i < 2; i++) product(l.m.mlp1, p.hidden + i * s.width, p.normed + i * s.width, false);
        __syncthreads();
        for (int k = warp; k < 2 * s.width; k += WARPS) at(p.token + k) += at(p.normed + k);
        __syncthreads();
    }

    /* x and v hold their encodings and tokens; the results are written to rows p.b .. p.b + 3. */
    __device__ void decode(const network_sizes &s, const float_layers &l, const float_places &p) const {
        int in = p.x;
        for (int i = 0; i < s.decoder_depth; i++) {
            const bool last = i == s.decoder_depth - 1, skip = i == s.decoder_skip && !last;
            const int out = last ? p.v : skip ? p.x + s.position_width + s.width : in == p.a ? p.b : p.a;
            product(l.m.pts[i], in, out, true);
            in = skip ? p.x : out;
            __syncthreads();
        }
        product(l.m.views, p.v, p.a, true);
        product(l.m.alpha, p.v, p.b + 3, false);
        __syncthreads();
        product(l.m.rgb, p.a, p.b, false);
        __syncthreads();
    }
};

__global__ static void __launch_bounds__(BLOCK)
    float_kernel(network_sizes s, float_layers l, network_points points, int64_t base, int64_t max,
                 const float *tokens, const float *color, float *space) {
    const float_places p = float_layout(s);
    const float_tile t = {space + (int64_t)blockIdx.x * p.rows * WARP, (int)threadIdx.x % WARP,
                          (int)threadIdx.x / WARP};
    const int64_t left = *points.count - base, end = left < max ? left : max;
    for (int64_t first = (int64_t)blockIdx.x * WARP; first < end; first += (int64_t)gridDim.x * WARP) {
        const bool real = first + t.lane < end; /* the others repeat the first point */
        const int64_t i = real ? first + t.lane : first, at = points.list[base + i];
        float rgb[3], x[3], d[3];
        for (int k = 0; k < 3; k++) {
            rgb[k] = color[3 * i + k];
            x[k] = points.canonical[3 * at + k];
            d[k] = points.direction[3 * at + k];
        }
        for (int k = t.warp; k < s.fused; k += WARPS)
            t.at(p.token + k) = tokens[i * s.fused + k] + l.token_b[k];
        t.encode(rgb, s.color_frequencies, s.color_width, p.color);
        t.encode(x, s.position_frequencies, s.position_width, p.x);
        t.encode(d, s.direction_frequencies, s.direction_width, p.v + s.decoder_width);
        __syncthreads();
        if (s.color_width) {
            t.product(l.m.color, p.color, p.normed, false);
            __syncthreads();
            for (int k = t.warp; k < l.m.color.rows; k += WARPS)
                t.at(p.token + s.color_token * s.width + k) += t.at(p.normed + k);
            __syncthreads();
        }
        t.transform(s, l, p);
        for (int k = t.warp; k < s.width; k += WARPS) {
            t.at(p.x + s.position_width + k) = t.at(p.token + k);
            t.at(p.v + s.decoder_width + s.direction_width + k) = t.at(p.token + s.width + k);
        }
        __syncthreads();
        t.decode(s, l, p);
        if (t.warp == 0 && real) {
            float y[3];
            for (int k = 0; k < 3; k++) y[k] = 1.002f / (1.0f + expf(-t.at(p.b + k))) - 0.001f;
            points.result[at] = make_float4(y[0], y[1], y[2], t.at(p.b + 3));
        }
        __syncthreads();
    }
}

void float_run(const placed_network *n, const network_points *points, int64_t base, int64_t max,
               const network_scratch *scratch) {
    const int64_t tiles = divided_up(max, WARP);
    const int blocks = tiles < float_blocks() ? (int)tiles : float_blocks();
    if (blocks > 0)
        launch(float_kernel, dim3((unsigned)blocks), dim3(BLOCK), n->s, n->layers, *points, base, max,
               (const float *)scratch->tokens, (const float *)scratch->color, scratch->layers);
}

} // namespace cuda_backend
