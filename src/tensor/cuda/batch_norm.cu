/* The CUDA kernels of batch_norm. saved: mean[C], 1 / standard deviation[C] (the third row of the shape rule
 * is not used here). */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

sherf_status batch_norm_forward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const batch_norm_attr a = *(const batch_norm_attr *)call->attr;
    const float *x = values(call->in[0]), *weight = values(call->in[1]), *bias = values(call->in[2]);
    float *running_mean = values(call->in[3]), *running_var = values(call->in[4]);
    float *y = values(call->out[0]), *mean = (float *)call->saved, *scale = mean + C;
    if (call->training) {
        sherf_status status = column_sums<1>(
            call, R, C, [=] __device__(int64_t r, int64_t c) { return several<1>{{x[r * C + c]}}; },
            [=] __device__(int64_t c, several<1> sum) { mean[c] = sum.v[0] / (float)R; });
        if (status != SHERF_OK) return status;
        status = column_sums<2>(
            call, R, C,
            [=] __device__(int64_t r, int64_t c) {
                const float d = x[r * C + c] - mean[c];
                return several<2>{{d * d, d}};
            },
            [=] __device__(int64_t c, several<2> sum) {
                /* the mean's rounding, removed from both */
                const float rest = sum.v[1] / (float)R, squares = sum.v[0] - rest * sum.v[1];
                mean[c] += rest;
                scale[c] = 1 / sqrtf(squares / (float)R + a.eps);
                running_mean[c] += a.momentum * (mean[c] - running_mean[c]);
                running_var[c] += a.momentum * (squares / (float)(R > 1 ? R - 1 : 1) - running_var[c]);
            });
        if (status != SHERF_OK) return status;
    } else {
        each(C, [=] __device__(int64_t c) {
            mean[c] = running_mean[c];
            scale[c] = 1 / sqrtf(running_var[c] + a.eps);
        });
    }
    each(R * C, [=] __device__(int64_t i) {
        const int64_t c = i % C;
        const float v = (x[i] - mean[c]) * scale[c] * weight[c] + bias[c];
        y[i] = a.relu && v < 0 ? 0 : v;
    });
    return finished(call);
}

sherf_status batch_norm_backward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const batch_norm_attr a = *(const batch_norm_attr *)call->attr;
    const bool training = call->training;
    const float *x = values(call->in[0]), *weight = values(call->in[1]), *y = values(call->out[0]);
    const float *dy = values(call->dout[0]), *mean = (const float *)call->saved, *scale = mean + C;
    float *dx = values(call->din[0]), *dweight = values(call->din[1]), *dbias = values(call->din[2]);
    float *sums =
        scratch<float>(call, 2 * C); /* over rows of g and g n, with n = (x - m) k and g = dy after relu */
    if (!sums) return SHERF_NO_MEMORY;
    auto passed = [=] __device__(int64_t i) -> float { return a.relu && y[i] <= 0 ? 0 : dy[i]; };
    sherf_status status = column_sums<2>(
        call, R, C,
        [=] __device__(int64_t r, int64_t c) {
            const int64_t i = r * C + c;
            const float g = passed(i);
            return several<2>{{g, g * (x[i] - mean[c]) * scale[c]}};
        },
        [=] __device__(int64_t c, several<2> sum) {
            sums[c] = sum.v[0];
            sums[C + c] = sum.v[1];
            if (dbias) dbias[c] += sum.v[0];
            if (dweight) dweight[c] += sum.v[1];
        });
    if (status != SHERF_OK) return status;
    if (dx) /* running statistics: dx = g weight k; batch: dx = weight k (g - mean g - n mean(g n)) */
        each(R * C, [=] __device__(int64_t i) {
            const int64_t c = i % C;
            const float n = (x[i] - mean[c]) * scale[c];
            float g = passed(i);
            if (training) g -= (sums[c] + n * sums[C + c]) / (float)R;
            dx[i] += weight[c] * scale[c] * g;
        });
    return finished(call);
}

} // namespace cuda_backend
