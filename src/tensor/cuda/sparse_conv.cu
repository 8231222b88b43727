/* Sparse convolutions in CUDA. Gathers, then multiplies: the 27 taps of every row are put next to each other,
 * zeros where the rule has none, and multiplied by w [O, 27 I]. In bands of rows. The backward pass inverts
 * the rule, so that every row of x gathers from the outputs that read it. */
#include "tensor/cuda/product.h"

namespace cuda_backend {

enum { TAPS = 27 };
constexpr int64_t gathered_floats = 32 << 20;

static int64_t band_of(int64_t rows, int64_t width) {
    const int64_t n = gathered_floats / width;
    return n < 1 ? 1 : n < rows ? n : rows;
}

static void gather(const float *x, const int32_t *rule, int64_t begin, int64_t count, int64_t I,
                   float *matrix) {
    each(count * TAPS * I, [=] __device__(int64_t i) {
        const int64_t from = rule[begin * TAPS + i / I];
        matrix[i] = from >= 0 ? x[from * I + i % I] : 0;
    });
}

sherf_status sparse_conv_forward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *rule = call->in[2];
    const int64_t A = rule->dim[0], I = x->dim[1], O = w->dim[0], K = TAPS * I;
    const int64_t band = band_of(A, K);
    float *y = values(call->out[0]), *matrix = scratch<float>(call, band * K);
    if (!matrix) return SHERF_NO_MEMORY;
    for (int64_t begin = 0; begin < A; begin += band) {
        const int64_t n = begin + band < A ? band : A - begin;
        gather(values(x), integers(rule), begin, n, I, matrix);
        sherf_status status =
            product(call, {n, O, K, false, true, K, K, O, 1, 0}, matrix, values(w), y + begin * O);
        if (status != SHERF_OK) return status;
    }
    return finished(call);
}

/* inverse[row of x][tap]: the row of y that reads it, or -1. A row occurs at most once in a tap, so no two
 * threads write the same place. */
static int32_t *inverse_rule(op_call *call, const tensor *rule, int64_t rows) {
    const int32_t *from = integers(rule);
    int32_t *inverse = scratch<int32_t>(call, rows * TAPS);
    if (!inverse) return nullptr;
    each(rows * TAPS, [=] __device__(int64_t i) { inverse[i] = -1; });
    each(rule->dim[0] * TAPS, [=] __device__(int64_t i) {
        if (from[i] >= 0) inverse[(int64_t)from[i] * TAPS + i % TAPS] = (int32_t)(i / TAPS);
    });
    return inverse;
}

sherf_status sparse_conv_backward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *rule = call->in[2];
    const int64_t A = rule->dim[0], I = x->dim[1], O = w->dim[0], K = TAPS * I, rows = x->dim[0];
    const int64_t band = band_of(A, K);
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]), *dw = values(call->din[1]);
    float *matrix = scratch<float>(call, band * K);
    const int32_t *inverse = dx ? inverse_rule(call, rule, rows) : nullptr;
    if (!matrix || (dx && !inverse)) return SHERF_NO_MEMORY;
    for (int64_t begin = 0; begin < A; begin += band) {
        const int64_t n = begin + band < A ? band : A - begin;
        sherf_status status = SHERF_OK;
        if (dw) { /* dw += dy^T gathered */
            gather(values(x), integers(rule), begin, n, I, matrix);
            status = product(call, {O, K, n, true, false, O, K, K, 1, 1}, dy + begin * O, matrix, dw);
        }
        if (dx && status == SHERF_OK) { /* dgathered = dy w */
            status = product(call, {n, K, O, false, false, O, K, K, 1, 0}, dy + begin * O, values(w), matrix);
            if (status == SHERF_OK)
                each(rows * I, [=] __device__(int64_t i) {
                    float sum = 0;
                    for (int64_t k = 0; k < TAPS; k++) {
                        const int64_t a = inverse[i / I * TAPS + k] - begin;
                        if (a >= 0 && a < n) sum += matrix[(a * TAPS + k) * I + i % I];
                    }
                    dx[i] += sum;
                });
        }
        if (status != SHERF_OK) return status;
    }
    return finished(call);
}

} // namespace cuda_backend
