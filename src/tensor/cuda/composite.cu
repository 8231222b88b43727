/* The CUDA kernels of compositing, one thread per ray; ref/spatial_composite.inc has the formulas. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

struct ray_sample {
    float depth, delta, alpha, pass;
};

struct rays {
    composite_attr a;
    const float *sigma, *rgb, *near, *far, *length, *place;
    const int32_t *first, *sample;
    explicit rays(const op_call *call)
        : a(*(const composite_attr *)call->attr), sigma(values(call->in[0])), rgb(values(call->in[1])),
          near(values(call->in[4])), far(values(call->in[5])), length(values(call->in[6])),
          place(values(call->in[7])), first(integers(call->in[2])), sample(integers(call->in[3])) {}
    __device__ ray_sample at(int64_t n, int64_t point) const {
        const float spacing = (far[n] - near[n]) / (float)(a.samples - 1);
        const int32_t i = sample[point];
        ray_sample s;
        s.depth = near[n] + spacing * (float)i;
        s.delta = i < a.samples - 1 ? spacing * length[n] : 1e10f;
        if (place) {
            s.depth = place[2 * point];
            s.delta = place[2 * point + 1] * length[n];
        }
        s.alpha = sigma[point] > 0 ? 1 - expf(-sigma[point] * s.delta) : 0;
        s.pass = 1 - s.alpha + 1e-10f;
        return s;
    }
};

sherf_status composite_forward(op_call *call) {
    const rays all(call);
    float *y = values(call->out[0]);
    each(tensor_count(call->in[4]), [=] __device__(int64_t n) {
        float T = 1, opacity = 0, depth = 0, colour[3] = {0, 0, 0};
        for (int64_t i = all.first[n]; i < all.first[n + 1]; i++) {
            const ray_sample s = all.at(n, i);
            const float w = s.alpha * T;
            for (int c = 0; c < 3; c++) colour[c] += w * all.rgb[3 * i + c];
            opacity += w;
            depth += w * s.depth;
            T *= s.pass;
        }
        for (int c = 0; c < 3; c++) y[5 * n + c] = colour[c] + (1 - opacity) * all.a.background;
        depth = opacity > 0 ? depth / opacity : all.a.depth_max;
        y[5 * n + 3] = opacity;
        y[5 * n + 4] = depth < all.a.depth_min   ? all.a.depth_min
                       : depth > all.a.depth_max ? all.a.depth_max
                                                 : depth;
    });
    return finished(call);
}

sherf_status composite_backward(op_call *call) {
    const rays all(call);
    const float *dy = values(call->dout[0]);
    float *dsigma = values(call->din[0]), *drgb = values(call->din[1]);
    float *light = scratch<float>(call, tensor_count(call->in[0])); /* light that reaches each sample */
    if (!light) return SHERF_NO_MEMORY;
    each(tensor_count(call->in[4]), [=] __device__(int64_t n) {
        const float *g = dy + 5 * n;
        float T = 1, behind = 0;
        for (int64_t i = all.first[n]; i < all.first[n + 1]; i++) {
            light[i] = T;
            T *= all.at(n, i).pass;
        }
        for (int64_t i = all.first[n + 1] - 1; i >= all.first[n]; i--) {
            const ray_sample s = all.at(n, i);
            float dw = g[3] - (g[0] + g[1] + g[2]) * all.a.background;
            for (int c = 0; c < 3; c++) dw += g[c] * all.rgb[3 * i + c];
            for (int c = 0; drgb && c < 3; c++) drgb[3 * i + c] += g[c] * s.alpha * light[i];
            if (dsigma && all.sigma[i] > 0)
                dsigma[i] += light[i] * (dw - behind) * s.delta * expf(-all.sigma[i] * s.delta);
            behind = dw * s.alpha + s.pass * behind;
        }
    });
    return finished(call);
}

} // namespace cuda_backend
