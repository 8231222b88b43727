/* softplus: a density that is never 0. Any shape. */
#include "tensor/ops/shape.h"

tensor *op_softplus(tape *t, tensor *x, float shift) {
    NEED(x);
    RULE(t, "softplus", x, is_real(t, x));
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    softplus_attr attr = {shift};
    return tape_call(t, OP_softplus, 1, &x, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
