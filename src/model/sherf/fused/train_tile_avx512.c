/* The float32 backward tile for AVX-512 (the build compiles this file for it). */
#if defined(__AVX512F__)
#define LANES 16
#define ROWS 12
#define VECTORS 2
#define KERNELS train_float_avx512
#include "model/sherf/fused/train_tile_float.h"
#else
typedef int nothing_here;
#endif
