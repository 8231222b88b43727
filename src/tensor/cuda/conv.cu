/* The CUDA kernels of conv2d and conv2d_transpose: patches times weights. The transposed convolution is the
 * gradient of a convolution of stride 2 without padding, so its passes are swapped. */
#include "tensor/cuda/product.h"

namespace cuda_backend {

/* The patches of a map are a matrix with one row for each place of the window. The row holds the window's
 * pixels tap by tap (row, column, channel), and zeros outside the map. A map is cut into bands of places, so
 * that the matrix has at most `patch_floats` values. */
constexpr int64_t patch_floats = 32 << 20;

struct patches {
    int64_t H, W, C;       /* the map */
    int64_t rows, columns; /* places of the window */
    int64_t k, stride, pad;
    int64_t width() const { return k * k * C; }
    int64_t places() const { return rows * columns; }
    /* Places in a band. */
    int64_t band() const {
        const int64_t n = patch_floats / width();
        return n < 1 ? 1 : n < places() ? n : places();
    }
};

/* matrix [count, k k C] of the places from `begin`. */
static void patches_take(const patches &p, const float *map, int64_t begin, int64_t count, float *matrix) {
    const int64_t width = p.width();
    each(count * width, [=] __device__(int64_t i) {
        const int64_t place = begin + i / width, tap = i % width / p.C;
        const int64_t row = place / p.columns * p.stride + tap / p.k - p.pad;
        const int64_t column = place % p.columns * p.stride + tap % p.k - p.pad;
        const bool inside = row >= 0 && row < p.H && column >= 0 && column < p.W;
        matrix[i] = inside ? map[(row * p.W + column) * p.C + i % p.C] : 0;
    });
}

/* Adds to map every pixel's values in the matrix of the places from `begin`. */
static void patches_give(const patches &p, const float *matrix, int64_t begin, int64_t count, float *map) {
    const int64_t width = p.width();
    each(p.H * p.W * p.C, [=] __device__(int64_t i) {
        const int64_t c = i % p.C, row = i / p.C / p.W + p.pad, column = i / p.C % p.W + p.pad;
        float sum = 0;
        for (int64_t r = 0; r < p.k; r++) {
            const int64_t down = row - r; /* stride times the window's row */
            if (down < 0 || down % p.stride || down / p.stride >= p.rows) continue;
            for (int64_t s = 0; s < p.k; s++) {
                const int64_t across = column - s;
                if (across < 0 || across % p.stride || across / p.stride >= p.columns) continue;
                const int64_t place = down / p.stride * p.columns + across / p.stride - begin;
                if (place >= 0 && place < count) sum += matrix[place * width + (r * p.k + s) * p.C + c];
            }
        }
        map[i] += sum;
    });
}

/* The index in [O, k, k, I], or with outputs_inside in [k, k, O, I], of value i of [O, I, k, k]. */
struct taps {
    int64_t O, I, K; /* K = k k */
    bool outputs_inside;
    taps(const tensor *w, bool inside)
        : O(w->dim[0]), I(w->dim[1]), K(w->dim[2] * w->dim[3]), outputs_inside(inside) {}
    __device__ int64_t place(int64_t i) const {
        const int64_t o = i / (I * K), c = i / K % I, tap = i % K;
        return outputs_inside ? (tap * O + o) * I + c : (o * K + tap) * I + c;
    }
};

/* Copies w to such a matrix; adds such a matrix to w. */
static void taps_take(const tensor *w, bool outputs_inside, float *out) {
    const taps t(w, outputs_inside);
    const float *from = values(w);
    each(tensor_count(w), [=] __device__(int64_t i) { out[t.place(i)] = from[i]; });
}

static void taps_give(const float *from, bool outputs_inside, tensor *w) {
    const taps t(w, outputs_inside);
    float *to = values(w);
    each(tensor_count(w), [=] __device__(int64_t i) { to[i] += from[t.place(i)]; });
}

sherf_status conv2d_forward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *out = call->out[0];
    const conv2d_attr a = *(const conv2d_attr *)call->attr;
    const int64_t O = w->dim[0];
    const patches p = {x->dim[0], x->dim[1], x->dim[2], out->dim[0], out->dim[1], w->dim[2], a.stride, a.pad};
    const int64_t K = p.width(), band = p.band();
    float *weights = scratch<float>(call, O * K), *matrix = scratch<float>(call, band * K);
    if (!weights || !matrix) return SHERF_NO_MEMORY;
    taps_take(w, false, weights);
    for (int64_t begin = 0; begin < p.places(); begin += band) {
        const int64_t n = begin + band < p.places() ? band : p.places() - begin;
        patches_take(p, values(x), begin, n, matrix);
        sherf_status status = product(call, {n, O, K, false, true, K, K, O, a.gain, 0}, matrix, weights,
                                      values(out) + begin * O);
        if (status != SHERF_OK) return status;
    }
    return finished(call);
}

sherf_status conv2d_backward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *out = call->out[0];
    const conv2d_attr a = *(const conv2d_attr *)call->attr;
    const int64_t O = w->dim[0];
    const patches p = {x->dim[0], x->dim[1], x->dim[2], out->dim[0], out->dim[1], w->dim[2], a.stride, a.pad};
    const int64_t K = p.width(), band = p.band();
    const float *dy = values(call->dout[0]);
    tensor *dx = call->din[0], *dw = call->din[1];
    float *weights = scratch<float>(call, O * K), *dweights = scratch<float>(call, O * K);
    float *matrix = scratch<float>(call, band * K);
    if (!weights || !dweights || !matrix) return SHERF_NO_MEMORY;
    taps_take(w, false, weights);
    for (int64_t begin = 0; begin < p.places(); begin += band) {
        const int64_t n = begin + band < p.places() ? band : p.places() - begin;
        sherf_status status = SHERF_OK;
        if (dw) { /* dw = gain dy^T patches */
            patches_take(p, values(x), begin, n, matrix);
            status = product(call, {O, K, n, true, false, O, K, K, a.gain, begin ? 1.f : 0.f}, dy + begin * O,
                             matrix, dweights);
        }
        if (dx && status == SHERF_OK) { /* dpatches = gain dy w */
            status =
                product(call, {n, K, O, false, false, O, K, K, a.gain, 0}, dy + begin * O, weights, matrix);
            if (status == SHERF_OK) patches_give(p, matrix, begin, n, values(dx));
        }
        if (status != SHERF_OK) return status;
    }
    if (dw) taps_give(dweights, false, dw);
    return finished(call);
}

/* The windows of y that belong to the pixels of x. */
static patches transposed(const op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *y = call->out[0];
    return {y->dim[0], y->dim[1], y->dim[2], x->dim[0], x->dim[1], w->dim[2], 2, 0};
}

sherf_status conv2d_transpose_forward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *out = call->out[0];
    const patches p = transposed(call);
    const int64_t I = w->dim[1], K = p.width(), band = p.band();
    float *y = values(out);
    float *weights = scratch<float>(call, K * I), *matrix = scratch<float>(call, band * K);
    if (!weights || !matrix) return SHERF_NO_MEMORY;
    taps_take(w, true, weights);
    each(tensor_count(out), [=] __device__(int64_t i) { y[i] = 0; });
    for (int64_t begin = 0; begin < p.places(); begin += band) {
        const int64_t n = begin + band < p.places() ? band : p.places() - begin;
        sherf_status status =
            product(call, {n, K, I, false, true, I, I, K, 1, 0}, values(x) + begin * I, weights, matrix);
        if (status != SHERF_OK) return status;
        patches_give(p, matrix, begin, n, y);
    }
    return finished(call);
}

sherf_status conv2d_transpose_backward(op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1];
    const patches p = transposed(call);
    const int64_t I = w->dim[1], K = p.width(), band = p.band();
    const float *dy = values(call->dout[0]);
    tensor *dx = call->din[0], *dw = call->din[1];
    float *weights = scratch<float>(call, K * I), *dweights = scratch<float>(call, K * I);
    float *matrix = scratch<float>(call, band * K);
    if (!weights || !dweights || !matrix) return SHERF_NO_MEMORY;
    taps_take(w, true, weights);
    for (int64_t begin = 0; begin < p.places(); begin += band) {
        const int64_t n = begin + band < p.places() ? band : p.places() - begin;
        sherf_status status = SHERF_OK;
        patches_take(p, dy, begin, n, matrix);
        if (dx) /* dx = patches of dy times w */
            status = product(call, {n, I, K, false, false, K, I, I, 1, 1}, matrix, weights,
                             values(dx) + begin * I);
        if (dw && status == SHERF_OK) /* dw = patches^T x */
            status = product(call, {K, I, n, true, false, K, I, I, 1, begin ? 1.f : 0.f}, matrix,
                             values(x) + begin * I, dweights);
        if (status != SHERF_OK) return status;
    }
    if (dw) taps_give(dweights, true, dw);
    return finished(call);
}

} // namespace cuda_backend
