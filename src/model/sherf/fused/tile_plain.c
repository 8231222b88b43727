/* The float32 tile for any processor: short vectors, which the compiler lowers to what there is. */
#define LANES 4
#define ROWS POINT_ROWS_PLAIN
#define VECTORS 2
#define TILE_FUNCTION point_tile_plain
#define PROJECT_FUNCTION point_project_plain
#define TILE_BYTES_FUNCTION point_tile_float_bytes
#include "model/sherf/fused/tile_float.h"
