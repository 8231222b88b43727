/* Weights' gradients of convolutions for NEON, of any shape, since oneDNN's depend on the number of threads
 * there. */
#if defined(__aarch64__)
#define LANES 4
#define U_BLOCK 8
#define VECTORS 2
#define LEVEL ISA_NEON
#define CHANNELS 1
#define WIDTH 1
#include "tensor/cpu/conv_weights_float.h"
#else
typedef int nothing_here;
#endif
