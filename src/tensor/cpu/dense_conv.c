/* conv2d, conv2d_transpose: our own kernels where they fit (AMX in bf16, wide pictures on AVX2, NEON), else
 * oneDNN. */
#include <string.h>

#include "tensor/cpu/amx_conv.h"
#include "tensor/cpu/conv_rows.h"
#include "tensor/cpu/conv_weights.h"
#include "tensor/cpu/conv_winograd.h"
#include "tensor/cpu/dnnl_conv.h"
#include "tensor/cpu/linear.h"

/* With fewer channels most of a tile is empty (three colours: 3 of 32). */
enum { FEW = 16 };

static conv_shape shape_of(const op_call *call, bool transpose) {
    const tensor *x = call->in[0], *w = call->in[1], *y = call->out[0];
    const conv2d_attr *a = transpose ? &(conv2d_attr){2, 0, 1} : call->attr;
    return (conv_shape){.transpose = transpose,
                        .stride = a->stride,
                        .pad = a->pad,
                        .gain = a->gain,
                        .H = x->dim[0],
                        .W = x->dim[1],
                        .I = x->dim[2],
                        .Ho = y->dim[0],
                        .Wo = y->dim[1],
                        .O = y->dim[2],
                        .k = w->dim[2]};
}

static bool is_bf16(const op_call *call) {
    return call->bf16 && isa_has_bf16();
}

static sherf_status forward(op_call *call, bool transpose) {
    const conv_shape s = shape_of(call, transpose);
    const bool few = s.I < FEW || s.O < FEW;
    if (is_bf16(call) && !few && amx_conv_fits(&s))
        return amx_conv_forward(call, &s, call->in[0]->data, call->in[1]->data, call->out[0]->data);
    if (conv_winograd_fits(&s))
        return conv_winograd_forward(call, &s, call->in[0]->data, call->in[1]->data, call->out[0]->data);
    if (conv_rows_fits(&s, false))
        return conv_rows_forward(call, &s, call->in[0]->data, call->in[1]->data, call->out[0]->data);
    /* 3-64 at 512 x 512, one thread: 7x7 4.4 ms in bf16, 10 in float32; 3x3 19 in bf16, 9 in float32 */
    return dnnl_conv_forward(call, transpose, is_bf16(call) && (!few || s.k > 3));
}

/* Runs a pass of oneDNN's; `alone`: on one thread, where its sums depend on the number of threads: gradients
 * of few channels' weights, and of pictures on AVX2. */
static sherf_status dnnl_on(op_call *call, bool alone, sherf_status (*pass)(op_call *, bool, bool),
                            bool transpose, bool bf16) {
    const int threads = call->c->threads;
    if (alone) call->c->threads = 1;
    const sherf_status status = pass(call, transpose, bf16);
    call->c->threads = threads;
    return status;
}

/* Weights' gradient of 1 x 1 kernels in float32: that of a linear layer over the pixels that are read.
 * oneDNN's sums over pixels depend on the number of threads here, except with stride 2 on AVX-512. */
static sherf_status pixel_weights(op_call *call, const conv_shape *s, const float *x, const float *dy,
                                  float *dw) {
    const linear_sizes n = {s->Ho * s->Wo, s->I, s->O, s->gain};
    if (s->stride == 1) return linear_weights_add(call, &n, x, dy, dw);
    float *read = arena_alloc(call->c, call->scratch, (size_t)(n.R * n.I), sizeof *read), *to = read;
    if (!read) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < s->Ho; i++)
        for (int64_t j = 0; j < s->Wo; j++, to += s->I)
            memcpy(to, x + (i * s->W + j) * s->stride * s->I, (size_t)s->I * sizeof *to);
    return linear_weights_add(call, &n, read, dy, dw);
}

static sherf_status backward(op_call *call, bool transpose) {
    const conv_shape s = shape_of(call, transpose);
    const bool few = s.I < FEW || s.O < FEW, amx = is_bf16(call) && amx_conv_fits(&s);
    const float *x = call->in[0]->data, *w = call->in[1]->data, *dy = call->dout[0]->data;
    sherf_status status = SHERF_OK;
    const arena_mark mark = arena_position(call->scratch);
    if (call->din[0] && amx) /* for 3 channels too: 20 ms against 28 in oneDNN's bf16 and 50 in float32 */
        status = amx_conv_data(call, &s, dy, w, !call->fresh[0], call->din[0]->data);
    else if (call->din[0] && conv_winograd_fits(&s))
        status = conv_winograd_data(call, &s, dy, w, !call->fresh[0], call->din[0]->data);
    else if (call->din[0] && conv_rows_fits(&s, true))
        status = conv_rows_data(call, &s, dy, w, !call->fresh[0], call->din[0]->data);
    else if (call->din[0])
        status = dnnl_on(call, s.I < FEW && isa_best() == ISA_AVX2, dnnl_conv_data, transpose, is_bf16(call));
    arena_rewind(call->scratch, mark);
    if (status != SHERF_OK || !call->din[1]) return status;
    if (amx && !few) return amx_conv_weights(call, &s, x, dy, call->din[1]->data);
    if (conv_weights_fits(&s)) return conv_weights_add(call, &s, x, dy, call->din[1]->data);
    if (!transpose && s.k == 1 && !s.pad && (s.stride == 1 || isa_best() <= ISA_AVX2))
        return pixel_weights(call, &s, x, dy, call->din[1]->data);
    return dnnl_on(call, s.I < FEW && s.O < FEW, dnnl_conv_weights, transpose, is_bf16(call) && !few);
}

sherf_status cpu_conv2d_forward(op_call *call) {
    return forward(call, false);
}
sherf_status cpu_conv2d_backward(op_call *call) {
    return backward(call, false);
}
sherf_status cpu_conv2d_transpose_forward(op_call *call) {
    return forward(call, true);
}
sherf_status cpu_conv2d_transpose_backward(op_call *call) {
    return backward(call, true);
}
