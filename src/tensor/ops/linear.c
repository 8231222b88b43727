/* linear: x's last dimension from I to O, the others kept; the bias is optional. */
#include "tensor/ops/shape.h"

tensor *op_linear(tape *t, tensor *x, tensor *w, tensor *b, float gain, float bias_gain) {
    NEED(x);
    NEED(w);
    RULE(t, "linear", x, is_real(t, x) && x->rank >= 1);
    RULE(t, "linear", w, is_real(t, w) && w->rank == 2 && w->dim[1] == tensor_columns(x) && w->dim[1] >= 1);
    if (b) RULE(t, "linear", b, is_real(t, b) && tensor_count(b) == w->dim[0]);
    tensor *y = with_columns(t, x, w->dim[0]);
    NEED(y);
    linear_attr attr = {gain, bias_gain};
    return tape_call(t, OP_linear, 3, (tensor *[]){x, w, b}, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
