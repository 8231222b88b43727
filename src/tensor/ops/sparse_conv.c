/* sparse_conv: kernels of 3 x 3 x 3 over active voxels; the rule [A, 27] says which row each tap reads. */
#include "tensor/ops/shape.h"

tensor *op_sparse_conv(tape *t, tensor *x, tensor *w, tensor *rule) {
    NEED(x);
    NEED(w);
    NEED(rule);
    RULE(t, "sparse_conv", x, is_real(t, x) && x->rank == 2);
    RULE(t, "sparse_conv", w,
         is_real(t, w) && w->rank == 5 && w->dim[1] == 3 && w->dim[2] == 3 && w->dim[3] == 3 &&
             w->dim[4] == x->dim[1]);
    RULE(t, "sparse_conv", rule, rule->type == T_I32 && rule->rank == 2 && rule->dim[1] == 27);
    tensor *y = tape_tensor(t, x->type, 2, (int64_t[]){rule->dim[0], w->dim[0]});
    NEED(y);
    return tape_call(t, OP_sparse_conv, 3, (tensor *[]){x, w, rule}, 1, &y, NULL, 0, 0) ? y : NULL;
}
