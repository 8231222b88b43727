/* The float32 tile for AVX2 with FMA (the build compiles this file for it). */
#if defined(__AVX2__)
#define LANES 8
#define ROWS 6
#define VECTORS 2
#define KERNELS radiance_avx2
#include "model/sherf/fused/tile_float.h"
#else
typedef int nothing_here;
#endif
