/* The arithmetic of training on whole blocks (tensor/block.h): sums of gradients, the optimiser, averages. */
#include "tensor/block.h"
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

static sherf_status add(context *c, int64_t n, float *to, const float *from) {
    each(n, [=] __device__(int64_t i) { to[i] += from[i]; });
    return finished(c, "a sum of gradients");
}

static sherf_status adam(context *c, int64_t n, float *values, float *first, float *second,
                         const float *gradients, adam_factors f) {
    each(n, [=] __device__(int64_t i) {
        const float g = gradients[i], v = f.beta2 * second[i] + (1 - f.beta2) * g * g;
        float m = g, rate = f.rate;
        if (first) {
            first[i] = m = f.beta1 * first[i] + (1 - f.beta1) * g;
            rate *= f.correction1;
        }
        second[i] = v;
        values[i] -= rate * m / (sqrtf(v * f.correction) + f.eps);
    });
    return finished(c, "an update of the weights");
}

static sherf_status average(context *c, int64_t n, float *to, const float *values, float decay) {
    each(n, [=] __device__(int64_t i) { to[i] = values[i] + decay * (to[i] - values[i]); });
    return finished(c, "a moving average");
}

static sherf_status square_sums(context *c, int64_t n, const float *x, double *sums) {
    auto square = [=] __device__(int64_t i) { return (double)x[i] * x[i]; };
    launch(parts_kernel<decltype(square)>, dim3(SQUARE_SUMS), dim3(BLOCK), n, sums, square);
    return finished(c, "a sum of squares");
}

static sherf_status mean_rows(context *c, int64_t rows, int64_t n, const float *from, float *to) {
    each(n, [=] __device__(int64_t i) {
        double sum = 0;
        for (int64_t r = 0; r < rows; r++) sum += from[r * n + i];
        to[i] = (float)(sum / (double)rows);
    });
    return finished(c, "a mean");
}

const block_kernels block_arithmetic = {add, adam, average, square_sums, mean_rows};

} // namespace cuda_backend
