/* Convolutions in float32: on AVX2 for pictures with wide rows, where oneDNN reaches half to two thirds of
 * the speed of products, and on NEON, where oneDNN has no optimised code. Forward, and backward to the data
 * as convolutions of the result's gradient. */
#ifndef SHERF_CONV_ROWS_H
#define SHERF_CONV_ROWS_H

#include "tensor/cpu/amx_conv.h"

/* Whether the kernel takes this shape, forward or backward to the data; on AVX2 without AVX-512, or NEON. */
bool conv_rows_fits(const conv_shape *s, bool back);
sherf_status conv_rows_forward(op_call *call, const conv_shape *s, const float *x, const float *w, float *y);
/* dx = ..., or with `add` dx += ... */
sherf_status conv_rows_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                            float *dx);
#endif
