/* sample_trilinear: sparse voxels read at P places, through a grid of row numbers. */
#include "tensor/ops/shape.h"

tensor *op_sample_trilinear(tape *t, tensor *x, tensor *grid, tensor *position) {
    NEED(x);
    NEED(grid);
    NEED(position);
    RULE(t, "sample_trilinear", x, is_real(t, x) && x->rank == 2);
    RULE(t, "sample_trilinear", grid, grid->type == T_I32 && grid->rank == 3);
    RULE(t, "sample_trilinear", position,
         is_real(t, position) && position->rank == 2 && position->dim[1] == 3);
    tensor *y = with_columns(t, position, x->dim[1]);
    NEED(y);
    return tape_call(t, OP_sample_trilinear, 3, (tensor *[]){x, grid, position}, 1, &y, NULL, 0, 0) ? y
                                                                                                    : NULL;
}
