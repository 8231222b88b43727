/* Convolutions on AMX tiles: float32 in and out, products in bf16, float32 sums. Needs ISA_AMX. */
#ifndef SHERF_AMX_CONV_H
#define SHERF_AMX_CONV_H

#include "tensor/cpu/cpu.h"

/* conv2d (stride 1 or 2) or conv2d_transpose of x [H,W,I] with w [O,I,k,k] to y [Ho,Wo,O]. */
typedef struct {
    bool transpose;
    int stride, pad; /* transpose: 2, 0 */
    float gain;
    int64_t H, W, I, Ho, Wo, O, k;
} conv_shape;

/* Whether the kernel takes this shape: stride 1 or 2, k up to 7. Channels are padded to a multiple of 32. */
bool amx_conv_fits(const conv_shape *s);
sherf_status amx_conv_forward(op_call *call, const conv_shape *s, const float *x, const float *w, float *y);
/* dx = ..., or with `add` dx += ...; dw += ... */
sherf_status amx_conv_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                           float *dx);
sherf_status amx_conv_weights(op_call *call, const conv_shape *s, const float *x, const float *dy, float *dw);
#endif
