/* Convolutions for NEON, of any shape, since oneDNN has only plain C++ for them there. */
#if defined(__aarch64__)
#define LANES 4
#define PIXELS 8
#define VECTORS 2
#define LEVEL ISA_NEON
#define KERNEL 1
#define CHANNELS 1
#define WIDTH 1
#include "tensor/cpu/conv_rows_float.h"
#else
typedef int nothing_here;
#endif
