/* sigmoid: a gain and an offset come behind it, as the decoder's colour has them. Any shape. */
#include "tensor/ops/shape.h"

tensor *op_sigmoid(tape *t, tensor *x, float gain, float offset) {
    NEED(x);
    RULE(t, "sigmoid", x, is_real(t, x));
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    sigmoid_attr attr = {gain, offset};
    return tape_call(t, OP_sigmoid, 1, &x, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
