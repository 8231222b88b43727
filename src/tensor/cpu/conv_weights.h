/* Weights' gradients of convolutions in float32: on AVX2, where oneDNN reaches a fifth of the processor's
 * peak on wide pictures, and on NEON. */
#ifndef SHERF_CONV_WEIGHTS_H
#define SHERF_CONV_WEIGHTS_H

#include "tensor/cpu/amx_conv.h"

/* Whether the kernel takes this shape: wide rows, whole panels of channels, an AVX2 processor without
 * AVX-512; or any, on NEON. */
bool conv_weights_fits(const conv_shape *s);
/* dw += gain * (x correlated with dy); the same bits for any number of threads. */
sherf_status conv_weights_add(op_call *call, const conv_shape *s, const float *x, const float *dy, float *dw);
#endif
