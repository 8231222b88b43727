/* Convolutions of wide pictures for AVX2 without AVX-512 (the build compiles this file for AVX2); on other
 * processors, stubs. */
#if defined(__AVX2__)
#define LANES 8
#define PIXELS 6
#define VECTORS 2
#define LEVEL ISA_AVX2
#define KERNEL 2
#define CHANNELS 16
#define WIDTH 32
#include "tensor/cpu/conv_rows_float.h"
#elif !defined(__aarch64__)
#include "tensor/cpu/conv_rows.h"

bool conv_rows_fits(const conv_shape *s, bool back) {
    return false;
}
sherf_status conv_rows_forward(op_call *call, const conv_shape *s, const float *x, const float *w, float *y) {
    return failure(call->c, SHERF_UNSUPPORTED, "no own convolutions for this processor");
}
sherf_status conv_rows_data(op_call *call, const conv_shape *s, const float *dy, const float *w, bool add,
                            float *dx) {
    return failure(call->c, SHERF_UNSUPPORTED, "no own convolutions for this processor");
}
#else
typedef int nothing_here;
#endif
