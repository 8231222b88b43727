/* The float32 tile for any processor: short vectors, which the compiler lowers to what there is. */
#define LANES 4
#define ROWS POINT_ROWS_PLAIN
#define VECTORS 2
#define TILE_FUNCTION radiance_tile_plain
#define PROJECT_FUNCTION radiance_project_plain
#define TILE_BYTES_FUNCTION radiance_tile_float_bytes
#include "model/sherf/fused/tile_float.h"
