/* The CUDA kernels of fir_upsample: each output gathers its 4 x 4 taps; in the backward pass each pixel of x
 * gathers from the outputs. */
#include "tensor/cuda/cuda.h"

namespace cuda_backend {

/* One axis of the filter: tap r of 1 3 3 1 / 8. */
__device__ static float fir_tap(int64_t r) {
    return r == 1 || r == 2 ? 0.375f : 0.125f;
}

/* Where tap r at output i reads, or -1 for padding and the zeros between pixels. */
__device__ static int64_t fir_source(const fir_attr &a, int64_t i, int64_t r, int64_t size) {
    const int64_t at = i + r - a.before;
    return at < 0 || at >= size * a.up || at % a.up ? -1 : at / a.up;
}

sherf_status fir_upsample_forward(op_call *call) {
    const tensor *in = call->in[0];
    const fir_attr a = *(const fir_attr *)call->attr;
    const int64_t H = in->dim[0], W = in->dim[1], C = in->dim[2], columns = call->out[0]->dim[1];
    const float *x = values(in);
    float *y = values(call->out[0]);
    each(tensor_count(call->out[0]), [=] __device__(int64_t i) {
        const int64_t c = i % C, out_row = i / C / columns, out_column = i / C % columns;
        float sum = 0;
        for (int64_t r = 0; r < 4; r++) {
            const int64_t row = fir_source(a, out_row, r, H);
            for (int64_t s = 0; s < 4 && row >= 0; s++) {
                const int64_t column = fir_source(a, out_column, s, W);
                if (column >= 0) sum += fir_tap(r) * fir_tap(s) * x[(row * W + column) * C + c];
            }
        }
        y[i] = sum * a.gain;
    });
    return finished(call);
}

/* Every pixel of x collects from the outputs that read it: output i with tap r where i + r - before = up row.
 */
sherf_status fir_upsample_backward(op_call *call) {
    const tensor *in = call->in[0], *out = call->out[0];
    const fir_attr a = *(const fir_attr *)call->attr;
    const int64_t W = in->dim[1], C = in->dim[2], rows = out->dim[0], columns = out->dim[1];
    const float *dy = values(call->dout[0]);
    float *dx = values(call->din[0]);
    each(tensor_count(in), [=] __device__(int64_t i) {
        const int64_t c = i % C, row = i / C / W * a.up + a.before, column = i / C % W * a.up + a.before;
        float sum = 0;
        for (int64_t r = 0; r < 4; r++)
            for (int64_t s = 0; s < 4; s++) {
                const int64_t from_row = row - r, from_column = column - s;
                if (from_row < 0 || from_row >= rows || from_column < 0 || from_column >= columns) continue;
                sum += fir_tap(r) * fir_tap(s) * dy[(from_row * columns + from_column) * C + c];
            }
        dx[i] += sum * a.gain;
    });
    return finished(call);
}

} // namespace cuda_backend
