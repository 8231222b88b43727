/* The CUDA kernels of concat and slice. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

sherf_status concat_forward(op_call *call) {
    const int64_t R = tensor_rows(call->out[0]), C = tensor_columns(call->out[0]);
    float *y = values(call->out[0]);
    for (int k = 0; k < OP_MAX_IN && call->in[k]; k++) {
        const int64_t width = tensor_columns(call->in[k]);
        const float *x = values(call->in[k]);
        each(R * width, [=] __device__(int64_t i) { y[i / width * C + i % width] = x[i]; });
        y += width;
    }
    return finished(call);
}

sherf_status concat_backward(op_call *call) {
    const int64_t R = tensor_rows(call->out[0]), C = tensor_columns(call->out[0]);
    const float *dy = values(call->dout[0]);
    for (int k = 0; k < OP_MAX_IN && call->in[k]; k++) { /* one after the other: two may be the same tensor */
        const int64_t width = tensor_columns(call->in[k]);
        float *dx = values(call->din[k]);
        if (dx) each(R * width, [=] __device__(int64_t i) { dx[i] += dy[i / width * C + i % width]; });
        dy += width;
    }
    return finished(call);
}

sherf_status slice_forward(op_call *call) {
    const slice_attr a = *(const slice_attr *)call->attr;
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]),
         [=] __device__(int64_t i) { y[i] = x[i / a.width * C + a.begin + i % a.width]; });
    return finished(call);
}

sherf_status slice_backward(op_call *call) {
    const slice_attr a = *(const slice_attr *)call->attr;
    const int64_t C = tensor_columns(call->in[0]);
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->out[0]),
         [=] __device__(int64_t i) { dx[i / a.width * C + a.begin + i % a.width] += dy[i]; });
    return finished(call);
}

} // namespace cuda_backend
