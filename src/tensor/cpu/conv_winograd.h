/* Convolutions of 3 x 3 with stride 1 in float32 by Winograd's F(4 x 4, 3 x 3) (Lavin and Gray, "Fast
 * Algorithms for Convolutional Neural Networks", CVPR 2016): 36 products instead of 144 for 16 outputs. For
 * AVX2 without AVX-512. Forward, and backward to the data. */
#ifndef SHERF_CONV_WINOGRAD_H
#define SHERF_CONV_WINOGRAD_H

#include "tensor/cpu/amx_conv.h"

/* Whether the kernel takes this shape, both forward and backward to the data. */
bool conv_winograd_fits(const conv_shape *s);
sherf_status conv_winograd_forward(op_call *call, const conv_shape *s, const float *x, const float *w,
                                   float *y);
/* dx = ..., or with `add` dx += ... */
sherf_status conv_winograd_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                                float *dx);
#endif
