/* The CUDA kernels of bias_act, add, scale, multiply, sine, mask_rows, shift_scale, gelu, sigmoid, softplus
 * and positional_encode: every output value depends on a few input values. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

sherf_status bias_act_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const bias_act_attr a = *(const bias_act_attr *)call->attr;
    const float *x = values(call->in[0]), *b = values(call->in[1]);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) {
        float v = x[i] + (b ? b[i % C] : 0);
        v = (v >= 0 ? v : a.slope * v) * a.gain;
        if (a.clamp > 0) v = v > a.clamp ? a.clamp : v < -a.clamp ? -a.clamp : v;
        y[i] = v;
    });
    return finished(call);
}

sherf_status bias_act_backward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const bias_act_attr a = *(const bias_act_attr *)call->attr;
    const float *x = values(call->in[0]), *b = values(call->in[1]);
    const float *y = values(call->out[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]), *db = values(call->din[1]);
    auto gradient = [=] __device__(int64_t i, int64_t c) -> float {
        if (a.clamp > 0 && (y[i] >= a.clamp || y[i] <= -a.clamp)) return 0;
        return dy[i] * a.gain * (x[i] + (b ? b[c] : 0) >= 0 ? 1 : a.slope);
    };
    if (dx) each(R * C, [=] __device__(int64_t i) { dx[i] += gradient(i, i % C); });
    sherf_status status = SHERF_OK;
    if (db)
        status = column_sums<1>(
            call, R, C, [=] __device__(int64_t r, int64_t c) { return several<1>{{gradient(r * C + c, c)}}; },
            [=] __device__(int64_t c, several<1> sum) { db[c] += sum.v[0]; });
    return status == SHERF_OK ? finished(call) : status;
}

sherf_status add_forward(op_call *call) {
    const float *a = values(call->in[0]), *b = values(call->in[1]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) { y[i] = a[i] + b[i]; });
    return finished(call);
}

sherf_status add_backward(op_call *call) {
    const float *dy = values(call->dout[0]);
    for (int k = 0; k < 2; k++) { /* one after the other: both may be the same tensor */
        float *dx = values(call->din[k]);
        if (dx) each(tensor_count(call->out[0]), [=] __device__(int64_t i) { dx[i] += dy[i]; });
    }
    return finished(call);
}

sherf_status scale_forward(op_call *call) {
    const float factor = *(const float *)call->attr, *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) { y[i] = factor * x[i]; });
    return finished(call);
}

sherf_status scale_backward(op_call *call) {
    const float factor = *(const float *)call->attr, *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) { dx[i] += factor * dy[i]; });
    return finished(call);
}

sherf_status multiply_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]), step = tensor_columns(call->in[1]) == C ? 1 : C;
    const float *a = values(call->in[0]), *b = values(call->in[1]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) { y[i] = a[i] * b[i / step]; });
    return finished(call);
}

sherf_status multiply_backward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]), step = tensor_columns(call->in[1]) == C ? 1 : C;
    const float *a = values(call->in[0]), *b = values(call->in[1]), *dy = values(call->dout[0]);
    float *da = values(call->din[0]), *db = values(call->din[1]);
    /* one after the other: both may be the same tensor */
    if (da) each(tensor_count(call->out[0]), [=] __device__(int64_t i) { da[i] += dy[i] * b[i / step]; });
    if (db)
        each(tensor_count(call->in[1]), [=] __device__(int64_t k) {
            float sum = 0;
            for (int64_t i = k * step; i < (k + 1) * step; i++) sum += dy[i] * a[i];
            db[k] += sum;
        });
    return finished(call);
}

sherf_status sine_forward(op_call *call) {
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) { y[i] = sinf(x[i]); });
    return finished(call);
}

sherf_status sine_backward(op_call *call) {
    const float *x = values(call->in[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) { dx[i] += dy[i] * cosf(x[i]); });
    return finished(call);
}

sherf_status mask_rows_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]);
    const int32_t *mask = integers(call->in[1]);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) { y[i] = mask[i / C] ? x[i] : 0; });
    return finished(call);
}

sherf_status mask_rows_backward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *dy = values(call->dout[0]);
    const int32_t *mask = integers(call->in[1]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) {
        if (mask[i / C]) dx[i] += dy[i];
    });
    return finished(call);
}

/* The source of the output's value i: rows of `width` pixels, `step` apart in the input. */
struct crop {
    int64_t C, width, first, step;
    __device__ int64_t source(int64_t i) const {
        const int64_t pixel = i / C;
        return (first + pixel / width * step + pixel % width) * C + i % C;
    }
};

static crop crop_of(const op_call *call) {
    const tensor *x = call->in[0];
    const shift_scale_attr *a = (const shift_scale_attr *)call->attr;
    const int64_t C = tensor_columns(x), rows = tensor_rows(x);
    if (a->width <= 0) return {C, rows > 0 ? rows : 1, 0, 0};
    return {C, a->width, a->top * x->dim[1] + a->left, x->dim[1]};
}

sherf_status shift_scale_forward(op_call *call) {
    const shift_scale_attr a = *(const shift_scale_attr *)call->attr;
    const crop from = crop_of(call);
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) {
        y[i] = (x[from.source(i)] - a.shift[i % from.C]) / a.scale[i % from.C];
    });
    return finished(call);
}

sherf_status shift_scale_backward(op_call *call) {
    const shift_scale_attr a = *(const shift_scale_attr *)call->attr;
    const crop from = crop_of(call);
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->out[0]),
         [=] __device__(int64_t i) { dx[from.source(i)] += dy[i] / a.scale[i % from.C]; });
    return finished(call);
}

sherf_status gelu_forward(op_call *call) {
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[0]),
         [=] __device__(int64_t i) { y[i] = x[i] * 0.5f * (1 + erff(x[i] * 0.70710678f)); });
    return finished(call);
}

sherf_status gelu_backward(op_call *call) {
    const float *x = values(call->in[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) {
        const float Phi = 0.5f * (1 + erff(x[i] * 0.70710678f));
        const float phi = expf(-0.5f * x[i] * x[i]) * 0.39894228f; /* 1 / sqrt(2 pi) */
        dx[i] += dy[i] * (Phi + x[i] * phi);
    });
    return finished(call);
}

sherf_status sigmoid_forward(op_call *call) {
    const sigmoid_attr a = *(const sigmoid_attr *)call->attr;
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[0]),
         [=] __device__(int64_t i) { y[i] = a.gain / (1 + expf(-x[i])) + a.offset; });
    return finished(call);
}

sherf_status sigmoid_backward(op_call *call) {
    const sigmoid_attr a = *(const sigmoid_attr *)call->attr;
    const float *x = values(call->in[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) {
        const float s = 1 / (1 + expf(-x[i]));
        dx[i] += dy[i] * a.gain * s * (1 - s);
    });
    return finished(call);
}

sherf_status softplus_forward(op_call *call) {
    const softplus_attr a = *(const softplus_attr *)call->attr;
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) {
        const float v = x[i] + a.shift;
        y[i] = (v > 0 ? v : 0) + log1pf(expf(-fabsf(v)));
    });
    return finished(call);
}

sherf_status softplus_backward(op_call *call) {
    const softplus_attr a = *(const softplus_attr *)call->attr;
    const float *x = values(call->in[0]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(call->in[0]),
         [=] __device__(int64_t i) { dx[i] += dy[i] / (1 + expf(-(x[i] + a.shift))); });
    return finished(call);
}

sherf_status positional_encode_forward(op_call *call) {
    const encode_attr a = *(const encode_attr *)call->attr;
    const int64_t D = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) {
        const int64_t j = i % a.width, block = j / D; /* 0: x itself, then sine and shifted sine of each */
        float v = x[i / a.width * D + j % D];
        if (block > 0) {
            v *= (float)(1 << (block - 1) / 2);
            if (block % 2 == 0) v += 1.57079633f;
            v = sinf(v);
        }
        y[i] = v;
    });
    return finished(call);
}

} // namespace cuda_backend
