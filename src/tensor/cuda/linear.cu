/* linear: cuBLAS's products (product.h), and a kernel that adds the bias. The bias's gradient is a sum over
 * rows. */
#include "tensor/cuda/product.h"

namespace cuda_backend {

sherf_status linear_forward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1];
    const linear_attr a = *(const linear_attr *)call->attr;
    const int64_t I = w->dim[1], O = w->dim[0], R = tensor_count(x) / I;
    const float *b = values(call->in[2]);
    float *y = values(call->out[0]);
    sherf_status status = product(call, {R, O, I, false, true, I, I, O, a.gain, 0}, values(x), values(w), y);
    if (status != SHERF_OK) return status;
    if (b) each(R * O, [=] __device__(int64_t i) { y[i] += b[i % O] * a.bias_gain; });
    return finished(call);
}

sherf_status linear_backward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1];
    const linear_attr a = *(const linear_attr *)call->attr;
    const int64_t I = w->dim[1], O = w->dim[0], R = tensor_count(x) / I;
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]), *dw = values(call->din[1]), *db = values(call->din[2]);
    sherf_status status = SHERF_OK;
    /* dx += gain dy w; dw += gain dy^T x; db += bias_gain sum_r dy */
    if (dx) status = product(call, {R, I, O, false, false, O, I, I, a.gain, 1}, dy, values(w), dx);
    if (dw && status == SHERF_OK)
        status = product(call, {O, I, R, true, false, O, I, I, a.gain, 1}, dy, values(x), dw);
    if (db && status == SHERF_OK)
        status = column_sums<1>(
            call, R, O, [=] __device__(int64_t r, int64_t o) { return several<1>{{dy[r * O + o]}}; },
            [=] __device__(int64_t o, several<1> sum) { db[o] += sum.v[0] * a.bias_gain; });
    return status == SHERF_OK ? finished(call) : status;
}

} // namespace cuda_backend
