/* The ops, one line each; tensor/ops.h documents them, ref/ defines them. Every backend has a kernel of the
 * same name for each pass, and all tables are made of this list.
 * BOTH: forward and gradient. FORWARD: no gradient. SHARED: as BOTH, but small: the CPU takes the
 * reference's kernels in float32. */
#ifndef SHERF_OP_LIST_H
#define SHERF_OP_LIST_H

#define OPS(BOTH, FORWARD, SHARED)                                                                           \
    BOTH(linear)                                                                                             \
    BOTH(conv2d)                                                                                             \
    BOTH(conv2d_transpose)                                                                                   \
    BOTH(fir_upsample)                                                                                       \
    BOTH(demodulation)                                                                                       \
    BOTH(scale_channels)                                                                                     \
    SHARED(normalize_moment) /* a vector, once a picture */                                                  \
    BOTH(batch_norm)                                                                                         \
    BOTH(bias_act)                                                                                           \
    BOTH(max_pool)                                                                                           \
    BOTH(average_pool)                                                                                       \
    BOTH(add)                                                                                                \
    BOTH(scale)                                                                                              \
    BOTH(concat)                                                                                             \
    BOTH(slice)                                                                                              \
    BOTH(mask_rows)                                                                                          \
    BOTH(sample_bilinear)                                                                                    \
    SHARED(scatter_mean) /* a body's vertices, once a step */                                                \
    BOTH(sparse_conv)                                                                                        \
    BOTH(sample_trilinear)                                                                                   \
    BOTH(layer_norm)                                                                                         \
    BOTH(token_attention)                                                                                    \
    BOTH(gelu)                                                                                               \
    BOTH(sigmoid)                                                                                            \
    SHARED(softplus) /* a density a point */                                                                 \
    FORWARD(positional_encode)                                                                               \
    BOTH(composite)                                                                                          \
    BOTH(mean_square)                                                                                        \
    BOTH(ssim)                                                                                               \
    BOTH(feature_distance)                                                                                   \
    SHARED(shift_scale) /* three channels of a picture */

#endif
