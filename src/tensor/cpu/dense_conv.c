/* conv2d, conv2d_transpose: our own AMX kernels in bf16 where they fit, else oneDNN. */
#include "tensor/cpu/amx_conv.h"
#include "tensor/cpu/dnnl_conv.h"

static bool use_amx(const op_call *call, bool transpose, conv_shape *s) {
    if (!call->bf16 || isa_best() < ISA_AMX) return false;
    const tensor *x = call->in[0], *w = call->in[1], *y = call->out[0];
    const conv2d_attr *a = transpose ? &(conv2d_attr){2, 0, 1} : call->attr;
    *s = (conv_shape){.transpose = transpose, .stride = a->stride, .pad = a->pad, .gain = a->gain};
    s->H = x->dim[0];
    s->W = x->dim[1];
    s->I = x->dim[2];
    s->Ho = y->dim[0];
    s->Wo = y->dim[1];
    s->O = y->dim[2];
    s->k = w->dim[2];
    return amx_conv_fits(s);
}

static sherf_status forward(op_call *call, bool transpose) {
    conv_shape s;
    if (!use_amx(call, transpose, &s)) return dnnl_conv_forward(call, transpose);
    return amx_conv_forward(call, &s, call->in[0]->data, call->in[1]->data, call->out[0]->data);
}

static sherf_status backward(op_call *call, bool transpose) {
    conv_shape s;
    const bool amx = use_amx(call, transpose, &s);
    const float *x = call->in[0]->data, *w = call->in[1]->data, *dy = call->dout[0]->data;
    sherf_status status = SHERF_OK;
    const arena_mark mark = arena_position(call->scratch);
    if (call->din[0])
        status = amx ? amx_conv_data(call, &s, dy, w, call->din[0]->data) : dnnl_conv_data(call, transpose);
    arena_rewind(call->scratch, mark);
    if (status == SHERF_OK && call->din[1])
        status =
            amx ? amx_conv_weights(call, &s, x, dy, call->din[1]->data) : dnnl_conv_weights(call, transpose);
    return status;
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
