/* The float32 tile for AVX-512 (the build compiles this file for it). */
#if defined(__AVX512F__)
#define LANES 16
#define ROWS POINT_ROWS_AVX512
#define VECTORS 4
#define TILE_FUNCTION radiance_tile_avx512
#define PROJECT_FUNCTION radiance_project_avx512
#include "model/sherf/fused/tile_float.h"
#else
typedef int nothing_here;
#endif
