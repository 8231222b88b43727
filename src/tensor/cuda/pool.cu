/* The CUDA kernels of max_pool and average_pool. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

/* saved: for every output the pixel that was the maximum. */
sherf_status max_pool_forward(op_call *call) {
    const tensor *in = call->in[0];
    const pool_attr a = *(const pool_attr *)call->attr;
    const int64_t H = in->dim[0], W = in->dim[1], C = in->dim[2], columns = call->out[0]->dim[1];
    const float *x = values(in);
    float *y = values(call->out[0]);
    int32_t *pixel = (int32_t *)call->saved;
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) {
        const int64_t c = i % C, top = i / C / columns * a.stride - a.pad;
        const int64_t left = i / C % columns * a.stride - a.pad;
        int64_t best = -1;
        for (int64_t row = top < 0 ? 0 : top; row < top + a.size && row < H; row++)
            for (int64_t column = left < 0 ? 0 : left; column < left + a.size && column < W; column++) {
                const int64_t at = row * W + column;
                if (best < 0 || x[at * C + c] > x[best * C + c]) best = at;
            }
        y[i] = x[best * C + c];
        pixel[i] = (int32_t)best;
    });
    return finished(call);
}

/* The first and the last window that start at or before `at` and still reach it. */
struct windows {
    int64_t first, last;
    __device__ windows(int64_t at, pool_attr a, int64_t count) {
        const int64_t from = at + a.pad - a.size + 1;
        first = from <= 0 ? 0 : (from + a.stride - 1) / a.stride;
        last = (at + a.pad) / a.stride;
        if (last >= count) last = count - 1;
    }
};

sherf_status max_pool_backward(op_call *call) {
    const tensor *in = call->in[0], *out = call->out[0];
    const pool_attr a = *(const pool_attr *)call->attr;
    const int64_t W = in->dim[1], C = in->dim[2], rows = out->dim[0], columns = out->dim[1];
    const float *dy = values(call->dout[0]);
    const int32_t *pixel = (const int32_t *)call->saved;
    float *dx = values(call->din[0]);
    each(tensor_count(in), [=] __device__(int64_t i) {
        const int64_t c = i % C, at = i / C;
        const windows down(at / W, a, rows), across(at % W, a, columns);
        float sum = 0;
        for (int64_t r = down.first; r <= down.last; r++)
            for (int64_t s = across.first; s <= across.last; s++) {
                const int64_t o = (r * columns + s) * C + c;
                if (pixel[o] == at) sum += dy[o];
            }
        dx[i] += sum;
    });
    return finished(call);
}

sherf_status average_pool_forward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    sherf_status status = column_sums<1>(
        call, R, C, [=] __device__(int64_t r, int64_t c) { return several<1>{{x[r * C + c]}}; },
        [=] __device__(int64_t c, several<1> sum) { y[c] = sum.v[0] / (float)R; });
    return status == SHERF_OK ? finished(call) : status;
}

sherf_status average_pool_backward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(R * C, [=] __device__(int64_t i) { dx[i] += dy[i % C] / (float)R; });
    return finished(call);
}

} // namespace cuda_backend
