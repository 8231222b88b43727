/* Packs weights in the device's memory into bf16 fragments for tensor cores: shared by the packing of the
 * forward layers (network_pack.cu) and of the backward pass (train_pack.cu). */
#ifndef SHERF_CUDA_PACK_H
#define SHERF_CUDA_PACK_H

#include "model/sherf/cuda/network_bf16.h"

namespace cuda_backend {

/* Rows of `columns` values, `pitch` apart; 0 if there is none. */
struct plain_matrix {
    const float *w;
    int rows, columns, pitch;
    __device__ float at(int row, int column) const {
        return row >= 0 && row < rows && column >= 0 && column < columns ? w[(int64_t)row * pitch + column]
                                                                         : 0;
    }
};

/* [left, right] */
__device__ inline float joined_at(const plain_matrix &left, const plain_matrix &right, int row, int column) {
    return column < left.columns ? left.at(row, column) : right.at(row, column - left.columns);
}

/* The network after the algebra that does not depend on points (radiance_matrices); all in the device's
 * memory. */
struct forward_weights {
    plain_matrix color, qkv, attention_out, mlp0, mlp1, alpha, rgb, pts[POINT_DECODER_MAX];
    plain_matrix views_h, views_rest; /* of h; of the encoded direction and token 1 */
    const float *token_b, *norm0_w, *norm0_b, *norm1_w, *norm1_b, *attention_out_b, *mlp0_b, *mlp1_b;
    const float *views_b, *rgb_b, *alpha_b, *pts_b[POINT_DECODER_MAX];
};

/* Stages are stored at a fixed distance, that of the widest, in 32-bit words. */
inline int stage_words(int h_tiles) {
    return STAGE_TILES * 2 * h_tiles * FRAGMENT;
}

/* Attention's scale, and log2 e for exp2. */
inline float query_scale(const network_sizes &s) {
    return 1.44269504f / sqrtf((float)s.head_width);
}

/* The fragments of k_tiles x n_tiles; value(output, input). */
template <typename F> void pack_kept(uint32_t *to, int k_tiles, int n_tiles, F value) {
    each(k_tiles * n_tiles * FRAGMENT, [=] __device__(int64_t i) {
        const int word = (int)(i % FRAGMENT), fragment = (int)(i / FRAGMENT);
        const int lane = word / 2, half = word % 2, k = fragment / n_tiles, n = fragment % n_tiles;
        const int in = 16 * k + 8 * half + 2 * (lane % 4), out = 8 * n + lane / 4;
        to[i] = pack_bf16(value(out, in), value(out, in + 1));
    });
}

/* The same as stages of the stream, in which a lane's 16 bytes are two neighbouring n-tiles; returns the
 * address after them. */
template <typename F> uint32_t *pack_stages(uint32_t *to, int each_words, int k_tiles, int n_tiles, F value) {
    each(k_tiles * n_tiles * FRAGMENT, [=] __device__(int64_t i) {
        const int word = (int)(i % FRAGMENT), fragment = (int)(i / FRAGMENT);
        const int lane = word / 2, half = word % 2, k = fragment / n_tiles, n = fragment % n_tiles;
        const int in = 16 * k + 8 * half + 2 * (lane % 4), out = 8 * n + lane / 4;
        to[k / STAGE_TILES * each_words + (k % STAGE_TILES * n_tiles / 2 + n / 2) * 2 * FRAGMENT + n % 2 * 2 +
           lane * 4 + half] = pack_bf16(value(out, in), value(out, in + 1));
    });
    return to + tiles_stages(k_tiles) * each_words;
}

/* network_pack.cu */
/* The number of stages that pack_forward makes. */
int forward_stages(const network_sizes &s, int h_tiles);
/* stream: forward_stages of stage_words; resident: resident_words; both zeroed. Returns the address after the
 * stages. */
uint32_t *pack_forward(const forward_weights &f, const network_sizes &s, int h_tiles, uint32_t *stream,
                       uint32_t *resident);

} // namespace cuda_backend
#endif
