/* The float32 tile for AVX-512 (the build compiles this file for it). */
#if defined(__AVX512F__)
#define LANES 16
#define ROWS 4
#define VECTORS 4
#define KERNELS radiance_avx512
#include "model/sherf/fused/tile_float.h"
#else
typedef int nothing_here;
#endif
