/* layer_norm: over the last dimension, with a weight and a bias a channel. */
#include "tensor/ops/shape.h"

tensor *op_layer_norm(tape *t, tensor *x, tensor *weight, tensor *bias) {
    NEED(x);
    NEED(weight);
    NEED(bias);
    RULE(t, "layer_norm", x, is_real(t, x) && x->rank >= 1 && tensor_columns(x) > 0);
    RULE(t, "layer_norm", weight, is_real(t, weight) && tensor_count(weight) == tensor_columns(x));
    RULE(t, "layer_norm", bias, is_real(t, bias) && tensor_count(bias) == tensor_columns(x));
    tensor *y = with_columns(t, x, tensor_columns(x));
    NEED(y);
    return tape_call(t, OP_layer_norm, 3, (tensor *[]){x, weight, bias}, 1, &y, NULL, 0, 0) ? y : NULL;
}
