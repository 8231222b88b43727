/* Weights' gradients of convolutions for AVX2 without AVX-512 (the build compiles this file for AVX2); on
 * other processors, stubs. */
#if defined(__AVX2__)
#define LANES 8
#define U_BLOCK 6
#define VECTORS 2
#define LEVEL ISA_AVX2
#define CHANNELS 16
#define WIDTH 32
#include "tensor/cpu/conv_weights_float.h"
#elif !defined(__aarch64__)
#include "tensor/cpu/conv_weights.h"

bool conv_weights_fits(const conv_shape *s) {
    return false;
}
sherf_status conv_weights_add(op_call *call, const conv_shape *s, const float *x, const float *dy,
                              float *dw) {
    return failure(call->c, SHERF_UNSUPPORTED, "no own convolutions for this processor");
}
#else
typedef int nothing_here;
#endif
