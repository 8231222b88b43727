/* The ops: their list, from which every table is made, and their declarations; ref/ has each op's shape rule
 * and definition, and every backend a kernel of the same name for each pass. Part of tensor.h. Each returns a
 * new tensor on the tape, or NULL once the tape has failed (NULL inputs then pass through silently, so model
 * code needs no checks). dX is the gradient of X. R rows, C channels. */
#ifndef SHERF_OPS_H
#define SHERF_OPS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef struct tensor tensor;
typedef struct tape tape;

/* BOTH: forward and gradient. FORWARD: no gradient. SHARED: as BOTH, but small: the CPU takes the reference's
 * kernels in float32. */
#define OPS(BOTH, FORWARD, SHARED)                                                                           \
    BOTH(linear)                                                                                             \
    BOTH(conv2d)                                                                                             \
    BOTH(conv2d_transpose)                                                                                   \
    BOTH(fir_upsample)                                                                                       \
    BOTH(demodulation)                                                                                       \
    BOTH(scale_channels)                                                                                     \
    SHARED(normalize_moment) /* one vector for each picture */                                               \
    BOTH(batch_norm)                                                                                         \
    BOTH(bias_act)                                                                                           \
    BOTH(max_pool)                                                                                           \
    BOTH(average_pool)                                                                                       \
    BOTH(add)                                                                                                \
    BOTH(scale)                                                                                              \
    SHARED(multiply) /* only for variants of the fusion, as is sine */                                       \
    SHARED(sine)                                                                                             \
    BOTH(concat)                                                                                             \
    BOTH(slice)                                                                                              \
    BOTH(mask_rows)                                                                                          \
    BOTH(sample_bilinear)                                                                                    \
    SHARED(scatter_mean) /* a body's vertices, once in each step */                                          \
    BOTH(sparse_conv)                                                                                        \
    BOTH(sample_trilinear)                                                                                   \
    BOTH(layer_norm)                                                                                         \
    BOTH(token_attention)                                                                                    \
    BOTH(gelu)                                                                                               \
    BOTH(sigmoid)                                                                                            \
    SHARED(softplus) /* one density for each point */                                                        \
    FORWARD(positional_encode)                                                                               \
    BOTH(composite)                                                                                          \
    BOTH(mean_square)                                                                                        \
    BOTH(ssim)                                                                                               \
    BOTH(feature_distance)                                                                                   \
    SHARED(shift_scale) /* three channels of a picture */

/* y[R,O] = x[R,I] w[O,I]^T * gain + b[O] * bias_gain; b may be NULL. x may have any rank (rows x last dim); y
 * keeps x's leading dimensions. */
typedef struct {
    float gain, bias_gain;
} linear_attr;
tensor *op_linear(tape *t, tensor *x, tensor *w, tensor *b, float gain, float bias_gain);

/* y[Ho,Wo,O] = correlation of x[H,W,I] with w[O,I,k,k], zero padding `pad` on every side; no bias. `gain`
 * multiplies w. */
typedef struct {
    int stride, pad;
    float gain;
} conv2d_attr;
tensor *op_conv2d(tape *t, tensor *x, tensor *w, int stride, int pad, float gain);

/* Transposed convolution, stride 2, no padding: y[2i + r, 2j + s, o] += x[i, j, c] w[o, c, r, s];
 * y [2H + k - 2, 2W + k - 2, O], that is (2H + 1) for k = 3. w as stored [O, I, k, k]. */
tensor *op_conv2d_transpose(tape *t, tensor *x, tensor *w);

/* Inserts zeros between pixels (up = 1 or 2: up 1 inserts none), pads before/after, then correlates each
 * channel with the 4 x 4 FIR outer([1,3,3,1]) / 64 times gain. Output size: H * up + before + after - 3. (The
 * kernel is symmetric.) */
typedef struct {
    int up, before, after;
    float gain;
} fir_attr;
tensor *op_fir_upsample(tape *t, tensor *x, int up, int before, int after, float gain);

/* d[O] = 1 / sqrt(sum over I, k, k of (w[O,I,k,k] s[I])^2 + 1e-8) (StyleGAN2's demodulation). */
tensor *op_demodulation(tape *t, tensor *w, tensor *s);
/* y[R,C] = x[R,C] * s[C]. */
tensor *op_scale_channels(tape *t, tensor *x, tensor *s);
/* y = x / sqrt(mean(x^2 over the last dimension) + 1e-8). */
tensor *op_normalize_moment(tape *t, tensor *x);

/* Per channel over rows. training (the tape's): batch mean and biased variance normalise; the op updates the
 * running statistics (plain tensors, not differentiated) by `momentum` with the unbiased variance. Otherwise
 * the running statistics normalise. relu: y = max(y, 0) is fused after it. */
typedef struct {
    float eps, momentum;
    int relu;
} batch_norm_attr;
tensor *op_batch_norm(tape *t, tensor *x, tensor *weight, tensor *bias, tensor *running_mean,
                      tensor *running_var, float eps, float momentum, bool relu);

/* y = clamp(act(x + b) * gain, +/- clamp), act(v) = v >= 0 ? v : slope * v. b[C] or NULL; slope 0: ReLU, 1:
 * identity; clamp 0: none. The gradient is 0 where the clamp holds. */
typedef struct {
    float slope, gain, clamp;
} bias_act_attr;
tensor *op_bias_act(tape *t, tensor *x, tensor *b, float slope, float gain, float clamp);
static inline tensor *op_relu(tape *t, tensor *x) {
    return op_bias_act(t, x, NULL, 0, 1, 0);
}

/* size x size windows; padding counts as -infinity. First maximum wins. [H,W,C] */
typedef struct {
    int size, stride, pad;
} pool_attr;
tensor *op_max_pool(tape *t, tensor *x, int size, int stride, int pad);
/* [H,W,C] -> [C], mean over all pixels. */
tensor *op_average_pool(tape *t, tensor *x);

tensor *op_add(tape *t, tensor *a, tensor *b); /* same shape */
tensor *op_scale(tape *t, tensor *x, float factor);
tensor *op_multiply(tape *t, tensor *a, tensor *b); /* elementwise; b: same shape, or one column: a gate */
tensor *op_sine(tape *t, tensor *x);
/* Concatenates columns: count (2 to 4) tensors with the same rows. */
tensor *op_concat(tape *t, int count, tensor *const *x);
/* Columns [begin, begin + width) of x: [R, width]. */
typedef struct {
    int64_t begin, width;
} slice_attr;
tensor *op_slice(tape *t, tensor *x, int64_t begin, int64_t width);
/* y[r] = mask[r] != 0 ? x[r] : 0; mask I32 [R]. */
tensor *op_mask_rows(tape *t, tensor *x, tensor *mask);

/* y[P,C] from map[H,W,C] at position[P,2] = (column, row) in pixels of the map, bilinear, zero outside: a
 * neighbour outside the map counts as zero. No gradient to the position. */
tensor *op_sample_bilinear(tape *t, tensor *map, tensor *position);

/* y[A,C] = mean of the rows v with index[v] == a; index I32 [V] in [0, A). Every a should have a row;
 * one without gets 0. */
typedef struct {
    int64_t voxels;
} scatter_attr;
tensor *op_scatter_mean(tape *t, tensor *x, tensor *index, int64_t voxels);

/* y[Ao,O]: y[o] = sum over k of W[:, k, :] x[rule[o, k]], W [O,3,3,3,I] flattened to 27 taps in z, y, x
 * order, rule I32 [Ao, 27], -1: none. Within one column of the rule (one tap) every row of x occurs at most
 * once, as in any convolution. */
tensor *op_sparse_conv(tape *t, tensor *x, tensor *w, tensor *rule);

/* y[P,C] from voxels x[A,C] through grid I32 [D,H,W] (row of x, or -1: zero), at position[P,3] = (x, y, z) in
 * voxel units of this grid, trilinear, zero outside. No gradient to the position. */
tensor *op_sample_trilinear(tape *t, tensor *x, tensor *grid, tensor *position);

/* Over the last dimension, eps 1e-5, then * weight + bias. */
tensor *op_layer_norm(tape *t, tensor *x, tensor *weight, tensor *bias);
/* qkv[P*T, 3*heads*width], each row q (heads x width), k, v; attention among each point's T tokens, scale
 * 1/sqrt(width) -> [P*T, heads*width]. */
typedef struct {
    int tokens, heads, width;
} attention_attr;
tensor *op_token_attention(tape *t, tensor *qkv, int tokens, int heads, int width);
tensor *op_gelu(tape *t, tensor *x); /* exact: x Phi(x) */
/* y = sigmoid(x) * gain + offset. */
typedef struct {
    float gain, offset;
} sigmoid_attr;
tensor *op_sigmoid(tape *t, tensor *x, float gain, float offset);

/* y = log(1 + exp(x + shift)). */
typedef struct {
    float shift;
} softplus_attr;
tensor *op_softplus(tape *t, tensor *x, float shift);

/* PE(x, n): [P, D] -> [P, width]: x, then for k < n: sin(2^k x), sin(2^k x + pi/2), each over all D
 * components. width is D (1 + 2n), or less to drop the last values. */
typedef struct {
    int frequencies;
    int64_t width;
} encode_attr;
tensor *op_positional_encode(tape *t, tensor *x, int frequencies, int64_t width);

/* Compositing (network.md 6). sigma[P,1] raw densities, rgb[P,3] of the kept samples, in ray-major then depth
 * order; first I32 [N+1]: the points of ray n are [first[n], first[n+1]); sample I32 [P]: their depth index;
 * near, far, length[N]: the ray's depths are near + (far - near) i / (S-1), length = |direction|. Samples
 * that were not kept have density -80 and colour 0. at[P,2]: each sample's depth and the depth step to the
 * next one; NULL: those even depths. Out: [N, 5] = r, g, b (over `background`), opacity, depth (sum w t /
 * opacity, clamped to depth_min..depth_max; depth_max if opacity is 0). The depth column gets no gradient,
 * nor do near, far, length and at. */
typedef struct {
    int samples;
    float background, depth_min, depth_max;
} composite_attr;
tensor *op_composite(tape *t, tensor *sigma, tensor *rgb, tensor *first, tensor *sample, tensor *near,
                     tensor *far, tensor *length, tensor *at, composite_attr attr);

/* Scalars have the shape [1]. Mean over the selected rows (mask I32 [R] nonzero; NULL: all rows) and all
 * columns of (x - y)^2; 0 when no row is selected. No gradient to y. */
tensor *op_mean_square(tape *t, tensor *x, tensor *y, tensor *mask);
/* Scalar: mean SSIM of x, y [H,W,C], 11 x 11 Gaussian window of sigma 1.5, no padding, k1 .01, k2 .03,
 * range 1. Gradient to x only. H, W >= 11. */
tensor *op_ssim(tape *t, tensor *x, tensor *y);
/* Scalar: a, b [H,W,C] features; each pixel divided by (its norm over channels + 1e-10); mean over pixels of
 * sum_c head[c] (a - b)^2 (LPIPS of one stage). head[C], or NULL: ones. Gradient to a only. */
tensor *op_feature_distance(tape *t, tensor *a, tensor *b, tensor *head);
/* y[R,C] = (x - shift[c]) / scale[c]; constants, C <= 4 (LPIPS's input scaling). If width > 0, crops to the
 * rectangle first: x [H,W,C] -> [height,width,C]. */
typedef struct {
    float shift[4], scale[4];
    int64_t left, top, width, height;
} shift_scale_attr;
tensor *op_shift_scale(tape *t, tensor *x, const shift_scale_attr *attr);

#ifdef __cplusplus
}
#endif
#endif
