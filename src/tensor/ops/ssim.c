/* ssim: two pictures of one shape, at least as large as the window of 11 x 11, to a scalar. */
#include "tensor/ops/shape.h"

tensor *op_ssim(tape *t, tensor *x, tensor *y) {
    NEED(x);
    NEED(y);
    RULE(t, "ssim", x, is_real(t, x) && x->rank == 3 && x->dim[0] >= 11 && x->dim[1] >= 11 && x->dim[2] > 0);
    RULE(t, "ssim", y, is_real(t, y) && tensor_same_shape(x, y));
    tensor *mean = tape_tensor(t, x->type, 1, (int64_t[]){1});
    NEED(mean);
    return tape_call(t, OP_ssim, 2, (tensor *[]){x, y}, 1, &mean, NULL, 0, 0) ? mean : NULL;
}
