/* mean_square: the loss of colour and mask, two tensors to a scalar, over all rows or those of a mask. */
#include "tensor/ops/shape.h"

tensor *op_mean_square(tape *t, tensor *x, tensor *y, tensor *mask) {
    NEED(x);
    NEED(y);
    RULE(t, "mean_square", x, is_real(t, x) && is_real(t, y));
    RULE(t, "mean_square", y, tensor_columns(x) == tensor_columns(y) && tensor_count(x) == tensor_count(y));
    if (mask) RULE(t, "mean_square", mask, mask->type == T_I32 && tensor_count(mask) == tensor_rows(x));
    tensor *loss = tape_tensor(t, x->type, 1, (int64_t[]){1});
    NEED(loss);
    return tape_call(t, OP_mean_square, 3, (tensor *[]){x, y, mask}, 1, &loss, NULL, 0, 0) ? loss : NULL;
}
