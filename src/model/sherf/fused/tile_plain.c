/* The float32 tile for any processor: short vectors, which the compiler lowers to its instructions. */
#define LANES 4
#define ROWS 4
#define VECTORS 2
#define KERNELS radiance_plain
#include "model/sherf/fused/tile_float.h"
