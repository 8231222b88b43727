/* Fusion in training, forward again and backward: from the gradient of its result (tokens 0 and 1) to that of
 * the sampled values. A warp takes 16 points; large intermediate values are computed twice, so that
 * everything stays in registers. Gradients of vectors are summed lane by lane in shared memory, and then in
 * each block's own part of r.vectors. */
#include "model/sherf/cuda/train.h"

namespace cuda_backend {

constexpr size_t fusion_shared =
    resident_max + back_max + WARPS * TILE_POINTS * ENCODED_PITCH * 2 + VECTOR_SLOTS * THREADS * 4;

/* Backward through a token's layer norm: d += its part; this lane's sums for weight and bias. */
static __device__ void norm_back(const network_warp &w, const sums *x, const sums *dy, int weight, sums *d,
                                 float *dweight, float *dbias) {
    float mean[2] = {0, 0}, scale[2] = {0, 0}, share[2] = {0, 0}, along[2] = {0, 0};
    sums unit[TOKEN_N], du[TOKEN_N];
    UNROLL
    for (int n = 0; n < TOKEN_N; n++)
        for (int e = 0; e < 4; e++) mean[e / 2] += x[n].c[e];
    for (int i = 0; i < 2; i++) mean[i] = quad_sum(mean[i]) * (1.0f / TOKEN);
    UNROLL
    for (int n = 0; n < TOKEN_N; n++)
        for (int e = 0; e < 4; e++) {
            unit[n].c[e] = x[n].c[e] - mean[e / 2];
            scale[e / 2] += unit[n].c[e] * unit[n].c[e];
        }
    for (int i = 0; i < 2; i++) scale[i] = 1.0f / sqrtf(quad_sum(scale[i]) * (1.0f / TOKEN) + 1e-5f);
    UNROLL
    for (int n = 0; n < TOKEN_N; n++)
        for (int e = 0; e < 4; e++) {
            unit[n].c[e] *= scale[e / 2];
            du[n].c[e] = dy[n].c[e] * w.values[weight + 8 * n + 2 * w.t + e % 2];
            share[e / 2] += du[n].c[e];
            along[e / 2] += du[n].c[e] * unit[n].c[e];
        }
    for (int i = 0; i < 2; i++) {
        share[i] = quad_sum(share[i]) * (1.0f / TOKEN);
        along[i] = quad_sum(along[i]) * (1.0f / TOKEN);
    }
    UNROLL
    for (int n = 0; n < TOKEN_N; n++) {
        for (int e = 0; e < 4; e++)
            d[n].c[e] += (du[n].c[e] - share[e / 2] - unit[n].c[e] * along[e / 2]) * scale[e / 2];
        for (int e = 0; e < 2; e++) {
            dweight[(2 * n + e) * THREADS] += dy[n].c[e] * unit[n].c[e] + dy[n].c[e + 2] * unit[n].c[e + 2];
            dbias[(2 * n + e) * THREADS] += dy[n].c[e] + dy[n].c[e + 2];
        }
    }
}

/* One head's queries, keys and values, and the attention weights of tokens 0 and 1: chance[i][j][point]. */
struct head_state {
    sums q[2][2], k[3][2], v[3][2];
    float chance[2][3][2];

    __device__ void make(const network_warp &w, const input (*x)[TOKEN_TILES], int first) {
        UNROLL
        for (int i = 0; i < 3; i++) {
            UNROLL
            for (int n = 0; n < 2; n++) {
                if (i < 2) q[i][n] = {};
                k[i][n] = v[i][n] = {};
            }
            if (i < 2) w.template product<TOKEN_TILES, 2>(x[i], first, q[i]);
            w.template product<TOKEN_TILES, 2>(x[i], first + 4, k[i]);
            w.template product<TOKEN_TILES, 2>(x[i], first + 8, v[i]);
        }
        UNROLL
        for (int i = 0; i < 2; i++) {
            UNROLL
            for (int r = 0; r < 2; r++) {
                float dot[3], sum = 0;
                UNROLL
                for (int j = 0; j < 3; j++) dot[j] = along(q[i], k[j], r);
                const float top = fmaxf(fmaxf(dot[0], dot[1]), dot[2]);
                for (int j = 0; j < 3; j++) sum += dot[j] = exp2f(dot[j] - top);
                for (int j = 0; j < 3; j++) chance[i][j][r] = dot[j] / sum;
            }
        }
    }

    /* The dot product over 16 channels of point g + 8 r. */
    static __device__ float along(const sums *a, const sums *b, int r) {
        float sum = 0;
        for (int n = 0; n < 2; n++)
            for (int e = 2 * r; e < 2 * r + 2; e++) sum += a[n].c[e] * b[n].c[e];
        return quad_sum(sum);
    }

    __device__ input mixed(int i) const {
        sums y[2] = {};
        UNROLL
        for (int n = 0; n < 2; n++)
            for (int e = 0; e < 4; e++)
                for (int j = 0; j < 3; j++) y[n].c[e] += chance[i][j][e / 2] * v[j][n].c[e];
        return input_of(y[0], y[1]);
    }

    /* d: of both tokens' attention results. out[token][q, k, v]; scores are in powers of 2, hence ln 2. */
    __device__ void back(const sums (*d)[2], input (*out)[3]) const {
        float e[2][3][2];
        UNROLL
        for (int i = 0; i < 2; i++) {
            UNROLL
            for (int r = 0; r < 2; r++) {
                float mean = 0;
                UNROLL
                for (int j = 0; j < 3; j++) {
                    e[i][j][r] = along(d[i], v[j], r);
                    mean += chance[i][j][r] * e[i][j][r];
                }
                for (int j = 0; j < 3; j++) e[i][j][r] = 0.69314718f * chance[i][j][r] * (e[i][j][r] - mean);
            }
        }
        UNROLL
        for (int j = 0; j < 3; j++) {
            sums dq[2] = {}, dk[2] = {}, dv[2] = {};
            UNROLL
            for (int n = 0; n < 2; n++)
                for (int c = 0; c < 4; c++) {
                    for (int m = 0; m < 3; m++)
                        if (j < 2) dq[n].c[c] += e[j < 2 ? j : 0][m][c / 2] * k[m][n].c[c];
                    for (int i = 0; i < 2; i++) {
                        dk[n].c[c] += e[i][j][c / 2] * q[i][n].c[c];
                        dv[n].c[c] += chance[i][j][c / 2] * d[i][n].c[c];
                    }
                }
            out[j][0] = input_of(dq[0], dq[1]);
            out[j][1] = input_of(dk[0], dk[1]);
            out[j][2] = input_of(dv[0], dv[1]);
        }
    }
};

struct fusion_warp {
    const train_run &r;
    network_warp w, back;
    resident_places at;
    back_places there;
    float *vector; /* this lane's first */
    uint4 *record;
    int64_t first, end; /* points of the chunk */

    __device__ int64_t place(int point) const { return first + point < end ? first + point : end - 1; }
    __device__ void keep_two(int tile, const input *x) const {
        for (int k = 0; k < TOKEN_TILES; k++) keep(record, tile + k, w.lane, x[k]);
    }
    __device__ static void inputs_of(const sums *y, input *out) {
        UNROLL
        for (int k = 0; k < TOKEN_TILES; k++) out[k] = input_of(y[2 * k], y[2 * k + 1]);
    }
    __device__ float *slot(int which) const { return vector + which * 8 * THREADS; }

    /* Forward through token i's feed-forward part and back: d, the gradient of its result, becomes that of
     * its input. */
    __device__ void feed_back(int i, const sums *token, sums *d) const {
        input x[TOKEN_TILES];
        sums pre[TOKEN_N], y[TOKEN_N];
        w.norm(token, at.norm1_w, at.norm1_b, x);
        keep_two(r.at.n1 + i * TOKEN_TILES, x);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++) pre[n] = bias_of(w.values + at.mlp0_b, n, w.t);
        w.template product<TOKEN_TILES, TOKEN_N>(x, at.mlp0, pre);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++)
            for (int e = 0; e < 4; e++) { /* from here on pre is the GELU's slope */
                const float v = pre[n].c[e], share = 0.5f * (1.0f + erff(v * 0.707106781f));
                y[n].c[e] = v * share;
                pre[n].c[e] = share + v * 0.39894228f * expf(-0.5f * v * v);
            }
        inputs_of(y, x);
        keep_two(r.at.gelu + i * TOKEN_TILES, x);
        inputs_of(d, x);
        keep_two(r.at.dlast + i * TOKEN_TILES, x);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++) y[n] = {};
        back.template product<TOKEN_TILES, TOKEN_N>(x, there.mlp1, y);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++)
            for (int e = 0; e < 4; e++) y[n].c[e] *= pre[n].c[e];
        inputs_of(y, x);
        keep_two(r.at.dpre + i * TOKEN_TILES, x);
        UNROLL
        for (int n = 0; n < TOKEN_N; n++) y[n] = {};
        back.template product<TOKEN_TILES, TOKEN_N>(x, there.mlp0, y);
        norm_back(w, token, y, at.norm1_w, d, slot(NORM1_W), slot(NORM1_B));
    }

    __device__ void load_gradient(int i, sums *d) const {
        UNROLL
        for (int n = 0; n < TOKEN_N; n++)
            for (int e = 0; e < 4; e++)
                d[n].c[e] =
                    r.dfused[(first + w.g + e / 2 * 8) * (2 * TOKEN) + i * TOKEN + 8 * n + 2 * w.t + e % 2];
    }

    /* Stores the gradient of sampled token i. */
    __device__ void store(int i, const sums *d) const {
        UNROLL
        for (int n = 0; n < TOKEN_N; n++) {
            for (int e = 0; e < 4; e++) {
                const int64_t row = first + w.g + e / 2 * 8;
                if (row < end)
                    r.dtokens[(r.base + row) * TOKENS + i * TOKEN + 8 * n + 2 * w.t + e % 2] = d[n].c[e];
            }
            for (int e = 0; e < 2; e++) slot(TOKEN_B + i)[(2 * n + e) * THREADS] += d[n].c[e] + d[n].c[e + 2];
        }
    }

    /* Takes the sampled tokens with the colour's encoding, their norms to x, and tokens 0 and 1 through the
     * attention. */
    __device__ void attend(const int64_t *rows, sums (*token)[TOKEN_N], input (*x)[TOKEN_TILES]) const {
        const network_sizes &s = r.s;
        load_tokens(r, w.values + at.token_b, rows, w.t, 3, token);
        if (s.color_width) {
            input encoded[COLOR_TILES];
            w.template encode<COLOR_TILES>([&](int p, int k) { return r.color[3 * place(p) + k]; },
                                           s.color_frequencies, s.color_width, encoded);
            for (int k = 0; k < COLOR_TILES; k++) keep(record, r.at.color + k, w.lane, encoded[k]);
            w.template product<COLOR_TILES, TOKEN_N>(encoded, at.color, token[2]);
        }
        UNROLL
        for (int i = 0; i < 3; i++) {
            w.norm(token[i], at.norm0_w, at.norm0_b, x[i]);
            keep_two(r.at.n0 + i * TOKEN_TILES, x[i]);
        }
        UNROLL
        for (int i = 0; i < 2; i++)
            for (int n = 0; n < TOKEN_N; n++) {
                const sums b = bias_of(w.values + at.out_b, n, w.t);
                for (int e = 0; e < 4; e++) token[i][n].c[e] += b.c[e];
            }
        for (int h = 0; h < s.heads; h++) {
            head_state head;
            head.make(w, x, at.heads + h * HEAD_EACH);
            UNROLL
            for (int i = 0; i < 2; i++) {
                const input y = head.mixed(i);
                keep(record, r.at.mixed + i * s.heads + h, w.lane, y);
                w.template product<1, TOKEN_N>(&y, at.heads + h * HEAD_EACH + HEAD_QKV, token[i]);
            }
        }
    }

    /* Back through the heads: from the gradient of their results to that of the norms. */
    __device__ void attend_back(const input (*x)[TOKEN_TILES], const input (*dattended)[TOKEN_TILES],
                                sums (*dnormed)[TOKEN_N]) const {
        const network_sizes &s = r.s;
        for (int h = 0; h < s.heads; h++) {
            const int from = there.heads + h * BACK_EACH;
            head_state head;
            head.make(w, x, at.heads + h * HEAD_EACH);
            sums dmixed[2][2] = {};
            input dqkv[3][3];
            UNROLL
            for (int i = 0; i < 2; i++) back.template product<TOKEN_TILES, 2>(dattended[i], from, dmixed[i]);
            head.back(dmixed, dqkv);
            UNROLL
            for (int j = 0; j < 3; j++) {
                UNROLL
                for (int part = 0; part < 3; part++)
                    keep(record, r.at.dqkv + (3 * j + part) * s.heads + h, w.lane, dqkv[j][part]);
                back.template product<3, TOKEN_N>(dqkv[j], from + BACK_OUT, dnormed[j]);
            }
        }
    }

    __device__ void run() const {
        const int64_t rows[2] = {place(w.g), place(w.g + 8)};
        input x[3][TOKEN_TILES];
        sums token[3][TOKEN_N];
        attend(rows, token, x);
        sums d[2][TOKEN_N], dnormed[3][TOKEN_N] = {};
        input dattended[2][TOKEN_TILES];
        UNROLL
        for (int i = 0; i < 2; i++) {
            load_gradient(i, d[i]);
            feed_back(i, token[i], d[i]);
            inputs_of(d[i], dattended[i]);
            keep_two(r.at.dattended + i * TOKEN_TILES, dattended[i]);
        }
        attend_back(x, dattended, dnormed);
        load_tokens(r, w.values + at.token_b, rows, w.t, 2, token);
        UNROLL
        for (int i = 0; i < 2; i++) {
            norm_back(w, token[i], dnormed[i], at.norm0_w, d[i], slot(NORM0_W), slot(NORM0_B));
            store(i, d[i]);
        }
        sums dlast[TOKEN_N] = {};
        norm_back(w, token[2], dnormed[2], at.norm0_w, dlast, slot(NORM0_W), slot(NORM0_B));
        store(2, dlast);
        inputs_of(dlast, x[0]);
        keep_two(r.at.dcolor, x[0]);
    }
};

static __global__ void __launch_bounds__(THREADS, 1) fusion_kernel(train_run r) {
    enum { ENCODED_BYTES = TILE_POINTS * ENCODED_PITCH * 2 };
    WIDE_SHARED(shared, fusion_shared);
    uint32_t *resident = (uint32_t *)shared, *back = resident + resident_max / 4,
             *encoded = back + back_max / 4;
    float *vector = (float *)(encoded + WARPS * ENCODED_BYTES / 4) + threadIdx.x;
    const int lane = (int)threadIdx.x % WARP, warp = (int)threadIdx.x / WARP;
    const network_sizes &s = r.s;
    const resident_places at = resident_layout(s.heads, h_tiles_of(s.decoder_width), s.decoder_depth);
    const back_places there = back_layout(s.heads);
    const int64_t end = chunk_points(r);
    const int64_t tiles = end > 0 ? (end + BLOCK_POINTS - 1) / BLOCK_POINTS : 0;
    if (blockIdx.x >= tiles) return;
    for (int i = (int)threadIdx.x; i < r.layers.resident_bytes / 16; i += THREADS)
        ((uint4 *)resident)[i] = r.layers.resident[i];
    for (int i = (int)threadIdx.x; i < there.fragments * FRAGMENT / 4; i += THREADS)
        ((uint4 *)back)[i] = r.back[i];
    for (int i = 0; i < VECTOR_SLOTS; i++) vector[i * THREADS] = 0;
    __syncthreads();
    const network_warp w = {resident,
                            (const float *)(resident + at.fragments * FRAGMENT),
                            (uint16_t *)encoded + warp * (ENCODED_BYTES / 2),
                            lane,
                            lane / 4,
                            lane % 4};
    network_warp wb = w;
    wb.fragments = back;
    for (int64_t tile = blockIdx.x; tile < tiles; tile += gridDim.x) {
        const int64_t group = tile * WARPS + warp;
        const fusion_warp f = {
            r, w, wb, at, there, vector, r.records + group * r.at.tiles * WARP, group * TILE_POINTS, end};
        f.run();
    }
    float *to = r.vectors + (int64_t)blockIdx.x * VECTOR_SLOTS * THREADS + threadIdx.x;
    for (int i = 0; i < VECTOR_SLOTS; i++) to[i * THREADS] += vector[i * THREADS];
}

void train_fusion(const train_run &r) {
    launch_wide(fusion_kernel, dim3(FUSION_BLOCKS), dim3(THREADS), fusion_shared, r);
}

} // namespace cuda_backend
