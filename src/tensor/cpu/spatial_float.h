/* The spatial inner loops. One file for each instruction set includes this; it defines LANES and
 * SPATIAL_TABLE. */
#include "base/simd.h"
#include "tensor/cpu/spatial_kernels.h"

#include "tensor/cpu/spatial_sample.inc"
#include "tensor/cpu/spatial_sparse.inc"
#include "tensor/cpu/spatial_token.inc"
#include "tensor/cpu/spatial_composite.inc"
#include "tensor/cpu/spatial_loss.inc"

const spatial_table SPATIAL_TABLE = {
    .bilinear = bilinear,
    .bilinear_back = bilinear_back,
    .trilinear = trilinear,
    .trilinear_corners = trilinear_corners,
    .trilinear_back = trilinear_back,
    .sparse_rows = sparse_rows,
    .sparse_weights = sparse_weights,
    .norm = norm,
    .norm_back = norm_back,
    .attention = attention,
    .attention_back = attention_back,
    .gelu = gelu,
    .gelu_back = gelu_back,
    .sigmoid = sigmoid,
    .sigmoid_back = sigmoid_back,
    .encode = encode,
    .composite = composite,
    .composite_back = composite_back,
    .ssim_statistics = ssim_statistics,
    .ssim_gradient = ssim_gradient,
    .square = square,
    .square_back = square_back,
    .distance = distance,
    .distance_back = distance_back,
};
