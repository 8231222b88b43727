/* The float32 backward tile for NEON. */
#if defined(__aarch64__)
#define LANES 4
#define ROWS 8
#define VECTORS 2
#define KERNELS train_float_neon
#include "model/sherf/fused/train_tile_float.h"
#else
typedef int nothing_here;
#endif
