/* The CUDA kernels of demodulation, scale_channels and normalize_moment. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

sherf_status demodulation_forward(op_call *call) {
    const tensor *w = call->in[0];
    const int64_t taps = w->dim[2] * w->dim[3], each_out = w->dim[1] * taps;
    const float *v = values(w), *s = values(call->in[1]);
    float *d = values(call->out[0]);
    each_row(w->dim[0], [=] __device__(int64_t o, int lane) {
        float sum = 0;
        for (int64_t i = lane; i < each_out; i += WARP) {
            const float scaled = v[o * each_out + i] * s[i / taps];
            sum += scaled * scaled;
        }
        sum = warp_sum(sum);
        if (lane == 0) d[o] = 1 / sqrtf(sum + 1e-8f);
    });
    return finished(call);
}

sherf_status demodulation_backward(op_call *call) {
    const tensor *w = call->in[0];
    const int64_t O = w->dim[0], I = w->dim[1], taps = w->dim[2] * w->dim[3];
    const float *v = values(w), *s = values(call->in[1]), *d = values(call->out[0]);
    const float *dd = values(call->dout[0]);
    float *dw = values(call->din[0]), *ds = values(call->din[1]);
    if (dw) /* dw = -dd d^3 w s^2 */
        each(O * I * taps, [=] __device__(int64_t i) {
            const int64_t o = i / (I * taps), c = i / taps % I;
            dw[i] -= dd[o] * d[o] * d[o] * d[o] * v[i] * s[c] * s[c];
        });
    sherf_status status = SHERF_OK;
    if (ds) /* ds = -sum_o dd d^3 s sum_t w^2 */
        status = column_sums<1>(
            call, O, I,
            [=] __device__(int64_t o, int64_t i) {
                float squares = 0;
                for (int64_t t = 0; t < taps; t++) {
                    const float one = v[(o * I + i) * taps + t];
                    squares += one * one;
                }
                return several<1>{{-dd[o] * d[o] * d[o] * d[o] * squares}};
            },
            [=] __device__(int64_t i, several<1> sum) { ds[i] += sum.v[0] * s[i]; });
    return status == SHERF_OK ? finished(call) : status;
}

sherf_status scale_channels_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *s = values(call->in[1]);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) { y[i] = x[i] * s[i % C]; });
    return finished(call);
}

sherf_status scale_channels_backward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *s = values(call->in[1]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]), *ds = values(call->din[1]);
    if (dx) each(R * C, [=] __device__(int64_t i) { dx[i] += dy[i] * s[i % C]; });
    sherf_status status = SHERF_OK;
    if (ds)
        status = column_sums<1>(
            call, R, C,
            [=] __device__(int64_t r, int64_t c) { return several<1>{{dy[r * C + c] * x[r * C + c]}}; },
            [=] __device__(int64_t c, several<1> sum) { ds[c] += sum.v[0]; });
    return status == SHERF_OK ? finished(call) : status;
}

/* (mean_c x^2 + 1e-8)^(-1/2), in every lane */
__device__ static float inverse_moment(const float *x, int64_t C, int lane) {
    float sum = 0;
    for (int64_t c = lane; c < C; c += WARP) sum += x[c] * x[c];
    return 1 / sqrtf(warp_sum(sum) / (float)C + 1e-8f);
}

sherf_status normalize_moment_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each_row(tensor_rows(call->in[0]), [=] __device__(int64_t r, int lane) {
        const float q = inverse_moment(x + r * C, C, lane);
        for (int64_t c = lane; c < C; c += WARP) y[r * C + c] = x[r * C + c] * q;
    });
    return finished(call);
}

sherf_status normalize_moment_backward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *y = values(call->out[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each_row(tensor_rows(call->in[0]), [=] __device__(int64_t r, int lane) {
        const float q = inverse_moment(x + r * C, C, lane);
        float dot = 0;
        for (int64_t c = lane; c < C; c += WARP) dot += y[r * C + c] * dy[r * C + c];
        dot = warp_sum(dot);
        /* dx = q (dy - y mean_c(y dy)) */
        for (int64_t c = lane; c < C; c += WARP)
            dx[r * C + c] += q * (dy[r * C + c] - y[r * C + c] * dot / (float)C);
    });
    return finished(call);
}

} // namespace cuda_backend
