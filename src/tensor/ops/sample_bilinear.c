/* sample_bilinear: a map [H, W, C] read at P places. */
#include "tensor/ops/shape.h"

tensor *op_sample_bilinear(tape *t, tensor *map, tensor *position) {
    NEED(map);
    NEED(position);
    RULE(t, "sample_bilinear", map, is_real(t, map) && map->rank == 3);
    RULE(t, "sample_bilinear", position,
         is_real(t, position) && position->rank == 2 && position->dim[1] == 2);
    tensor *y = with_columns(t, position, map->dim[2]);
    NEED(y);
    return tape_call(t, OP_sample_bilinear, 2, (tensor *[]){map, position}, 1, &y, NULL, 0, 0) ? y : NULL;
}
