/* conv2d, conv2d_transpose, fir_upsample: from map [H, W, C] to map; kernels are square. */
#include "tensor/ops/shape.h"

static bool is_map(tape *t, const tensor *x) {
    return is_real(t, x) && x->rank == 3 && x->dim[0] >= 1 && x->dim[1] >= 1 && x->dim[2] >= 1;
}

/* A square kernel [O, I, k, k] for a map of I channels. */
static bool is_kernel_of(tape *t, const tensor *w, const tensor *x) {
    return is_real(t, w) && w->rank == 4 && w->dim[0] >= 1 && w->dim[1] == x->dim[2] && w->dim[2] >= 1 &&
           w->dim[2] == w->dim[3];
}

tensor *op_conv2d(tape *t, tensor *x, tensor *w, int stride, int pad, float gain) {
    NEED(x);
    NEED(w);
    RULE(t, "conv2d", x, is_map(t, x));
    RULE(t, "conv2d", w, is_kernel_of(t, w, x) && stride >= 1 && pad >= 0 && pad < w->dim[2]);
    const int64_t k = w->dim[2], H = x->dim[0] + 2 * pad - k, W = x->dim[1] + 2 * pad - k;
    RULE(t, "conv2d", x, H >= 0 && W >= 0);
    tensor *y = tape_tensor(t, x->type, 3, (int64_t[]){H / stride + 1, W / stride + 1, w->dim[0]});
    NEED(y);
    conv2d_attr attr = {stride, pad, gain};
    return tape_call(t, OP_conv2d, 2, (tensor *[]){x, w}, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}

tensor *op_conv2d_transpose(tape *t, tensor *x, tensor *w) {
    NEED(x);
    NEED(w);
    RULE(t, "conv2d_transpose", x, is_map(t, x));
    RULE(t, "conv2d_transpose", w, is_kernel_of(t, w, x));
    const int64_t k = w->dim[2];
    tensor *y =
        tape_tensor(t, x->type, 3, (int64_t[]){2 * x->dim[0] + k - 2, 2 * x->dim[1] + k - 2, w->dim[0]});
    NEED(y);
    return tape_call(t, OP_conv2d_transpose, 2, (tensor *[]){x, w}, 1, &y, NULL, 0, 0) ? y : NULL;
}

tensor *op_fir_upsample(tape *t, tensor *x, int up, int before, int after, float gain) {
    NEED(x);
    RULE(t, "fir_upsample", x, is_map(t, x) && (up == 1 || up == 2) && before >= 0 && after >= 0);
    const int64_t H = x->dim[0] * up + before + after - 3, W = x->dim[1] * up + before + after - 3;
    RULE(t, "fir_upsample", x, H >= 1 && W >= 1);
    tensor *y = tape_tensor(t, x->type, 3, (int64_t[]){H, W, x->dim[2]});
    NEED(y);
    fir_attr attr = {up, before, after, gain};
    return tape_call(t, OP_fir_upsample, 1, &x, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
