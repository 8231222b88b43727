/* The float32 tile for NEON. */
#if defined(__aarch64__)
#define LANES 4
#define ROWS 8
#define VECTORS 2
#define KERNELS radiance_neon
#include "model/sherf/fused/tile_float.h"
#else
typedef int nothing_here;
#endif
