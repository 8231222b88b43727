/* The CUDA kernels of mean_square, ssim and feature_distance, whose results are scalars. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

/* Writes the number of values in the mean to out[0]: selected rows times columns. */
static sherf_status selected(op_call *call, double *out) {
    const int64_t C = tensor_columns(call->in[0]);
    const int32_t *mask = integers(call->in[2]);
    return total(
        call, tensor_rows(call->in[0]),
        [=] __device__(int64_t r) -> double { return !mask || mask[r] ? 1 : 0; },
        [=] __device__(double rows) { *out = rows * (double)C; });
}

sherf_status mean_square_forward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *y = values(call->in[1]);
    const int32_t *mask = integers(call->in[2]);
    float *loss = values(call->out[0]);
    double *n = scratch<double>(call, 1);
    if (!n) return SHERF_NO_MEMORY;
    sherf_status status = selected(call, n);
    if (status != SHERF_OK) return status;
    status = total(
        call, tensor_count(call->in[0]),
        [=] __device__(int64_t i) -> double {
            if (mask && !mask[i / C]) return 0;
            return (double)(x[i] - y[i]) * (x[i] - y[i]);
        },
        [=] __device__(double sum) { *loss = *n > 0 ? (float)(sum / *n) : 0; });
    return status == SHERF_OK ? finished(call) : status;
}

sherf_status mean_square_backward(op_call *call) {
    const int64_t C = tensor_columns(call->in[0]);
    const float *x = values(call->in[0]), *y = values(call->in[1]), *dy = values(call->dout[0]);
    const int32_t *mask = integers(call->in[2]);
    float *dx = values(call->din[0]);
    double *n = scratch<double>(call, 1);
    if (!dx) return SHERF_OK;
    if (!n) return SHERF_NO_MEMORY;
    sherf_status status = selected(call, n);
    if (status != SHERF_OK) return status;
    each(tensor_count(call->in[0]), [=] __device__(int64_t i) {
        if (!mask || mask[i / C]) dx[i] += *dy * 2 * (x[i] - y[i]) / (float)*n;
    });
    return finished(call);
}

/* ---- SSIM ---- */
enum { WINDOW = 11 };

/* Means over one window, and from them its SSIM and the derivatives by the means of x, x^2 and x y. */
struct ssim_window {
    float tap[WINDOW]; /* a normalised Gaussian of sigma 1.5 */
    ssim_window() {
        double sum = 0, g[WINDOW];
        for (int i = 0; i < WINDOW; i++) sum += g[i] = exp(-(i - 5) * (i - 5) / (2 * 1.5 * 1.5));
        for (int i = 0; i < WINDOW; i++) tap[i] = (float)(g[i] / sum);
    }
    struct point {
        float value, by_x, by_xx, by_xy;
    };
    __device__ point at(const float *x, const float *y, int64_t row, int64_t C) const {
        const float c1 = 0.01f * 0.01f, c2 = 0.03f * 0.03f;
        float mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
        for (int i = 0; i < WINDOW; i++)
            for (int j = 0; j < WINDOW; j++) {
                const float w = tap[i] * tap[j], u = x[i * row + j * C], v = y[i * row + j * C];
                mx += w * u;
                my += w * v;
                xx += w * u * u;
                yy += w * v * v;
                xy += w * u * v;
            }
        const float A1 = 2 * mx * my + c1, A2 = 2 * (xy - mx * my) + c2;
        const float B1 = mx * mx + my * my + c1, B2 = xx - mx * mx + yy - my * my + c2;
        const float s = A1 * A2 / (B1 * B2);
        return {s, 2 * my * (A2 - A1) / (B1 * B2) + 2 * mx * s * (1 / B2 - 1 / B1), -s / B2,
                2 * A1 / (B1 * B2)};
    }
};

sherf_status ssim_forward(op_call *call) {
    const tensor *in = call->in[0];
    const int64_t H = in->dim[0] - 10, W = in->dim[1] - 10, C = in->dim[2], row = in->dim[1] * C;
    const float *x = values(in), *y = values(call->in[1]);
    float *mean = values(call->out[0]);
    const ssim_window window;
    sherf_status status = total(
        call, H * W * C,
        [=] __device__(int64_t i) -> double {
            const int64_t from = i / (W * C) * row + i % (W * C);
            return window.at(x + from, y + from, row, C).value;
        },
        [=] __device__(double sum) { *mean = (float)(sum / (double)(H * W * C)); });
    return status == SHERF_OK ? finished(call) : status;
}

/* First every window's derivatives; then every pixel gathers from the windows that contain it. */
sherf_status ssim_backward(op_call *call) {
    const tensor *in = call->in[0];
    const int64_t H = in->dim[0] - 10, W = in->dim[1] - 10, C = in->dim[2], row = in->dim[1] * C;
    const float *x = values(in), *y = values(call->in[1]), *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    const ssim_window window;
    ssim_window::point *all = scratch<ssim_window::point>(call, H * W * C);
    if (!dx) return SHERF_OK;
    if (!all) return SHERF_NO_MEMORY;
    each(H * W * C, [=] __device__(int64_t i) {
        const int64_t from = i / (W * C) * row + i % (W * C);
        all[i] = window.at(x + from, y + from, row, C);
    });
    each(tensor_count(in), [=] __device__(int64_t p) {
        const int64_t i = p / row, j = p % row / C, c = p % C;
        float sum = 0;
        for (int u = 0; u < WINDOW; u++)
            for (int v = 0; v < WINDOW; v++) {
                if (i - u < 0 || i - u >= H || j - v < 0 || j - v >= W) continue;
                const ssim_window::point &s = all[((i - u) * W + j - v) * C + c];
                sum += window.tap[u] * window.tap[v] * (s.by_x + 2 * x[p] * s.by_xx + y[p] * s.by_xy);
            }
        dx[p] += *dy / (float)(H * W * C) * sum;
    });
    return finished(call);
}

/* ---- LPIPS of one stage ---- */
__device__ static float norm_of(const float *a, int64_t C, int lane) {
    float sum = 0;
    for (int64_t c = lane; c < C; c += WARP) sum += a[c] * a[c];
    return sqrtf(warp_sum(sum));
}

sherf_status feature_distance_forward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const float *a = values(call->in[0]), *b = values(call->in[1]), *head = values(call->in[2]);
    float *mean = values(call->out[0]), *distance = scratch<float>(call, R);
    if (!distance) return SHERF_NO_MEMORY;
    each_row(R, [=] __device__(int64_t r, int lane) {
        const float *u = a + r * C, *v = b + r * C;
        const float su = 1 / (norm_of(u, C, lane) + 1e-10f), sv = 1 / (norm_of(v, C, lane) + 1e-10f);
        float sum = 0;
        for (int64_t c = lane; c < C; c += WARP) {
            const float d = u[c] * su - v[c] * sv;
            sum += (head ? head[c] : 1) * d * d;
        }
        sum = warp_sum(sum);
        if (lane == 0) distance[r] = sum;
    });
    sherf_status status = total(
        call, R, [=] __device__(int64_t r) -> double { return distance[r]; },
        [=] __device__(double sum) { *mean = (float)(sum / (double)R); });
    return status == SHERF_OK ? finished(call) : status;
}

sherf_status feature_distance_backward(op_call *call) {
    const int64_t R = tensor_rows(call->in[0]), C = tensor_columns(call->in[0]);
    const float *a = values(call->in[0]), *b = values(call->in[1]), *head = values(call->in[2]);
    const float *dy = values(call->dout[0]);
    float *da = values(call->din[0]);
    if (!da) return SHERF_OK;
    each_row(R, [=] __device__(int64_t r, int lane) {
        const float *u = a + r * C, *v = b + r * C, factor = 2 * *dy / (float)R;
        const float norm = norm_of(u, C, lane), sv = 1 / (norm_of(v, C, lane) + 1e-10f);
        const float su = 1 / (norm + 1e-10f);
        float dot = 0; /* du = 2 head (u - v) / R; da = du s - a (du . a) s^2 / |a|, s = 1 / (|a| + 1e-10) */
        for (int64_t c = lane; c < C; c += WARP)
            dot += factor * (head ? head[c] : 1) * (u[c] * su - v[c] * sv) * (u[c] * su);
        dot = warp_sum(dot);
        if (norm == 0) return; /* no direction: the gradient is taken as 0 */
        for (int64_t c = lane; c < C; c += WARP) {
            const float du = factor * (head ? head[c] : 1) * (u[c] * su - v[c] * sv);
            da[r * C + c] += su * (du - u[c] / norm * dot);
        }
    });
    return finished(call);
}

} // namespace cuda_backend
