/* scatter_mean: rows to the means of their voxels, as vertices enter the sparse volume. */
#include "tensor/ops/shape.h"

tensor *op_scatter_mean(tape *t, tensor *x, tensor *index, int64_t voxels) {
    NEED(x);
    NEED(index);
    RULE(t, "scatter_mean", x, is_real(t, x) && x->rank == 2 && voxels >= 0);
    RULE(t, "scatter_mean", index, index->type == T_I32 && tensor_count(index) == x->dim[0]);
    tensor *y = tape_tensor(t, x->type, 2, (int64_t[]){voxels, x->dim[1]});
    NEED(y);
    scatter_attr attr = {voxels};
    return tape_call(t, OP_scatter_mean, 2, (tensor *[]){x, index}, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
