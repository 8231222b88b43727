/* The float32 backward tile for any processor: short vectors, which the compiler lowers to its
 * instructions. */
#define LANES 4
#define ROWS 6
#define VECTORS 2
#define KERNELS train_float_plain
#include "model/sherf/fused/train_tile_float.h"
