/* max_pool: square windows of a map. average_pool: all its pixels. */
#include "tensor/ops/shape.h"

tensor *op_max_pool(tape *t, tensor *x, int size, int stride, int pad) {
    NEED(x);
    /* 2 pad <= size: no window lies in the padding altogether */
    RULE(t, "max_pool", x, is_real(t, x) && x->rank == 3 && x->dim[0] >= 1 && x->dim[1] >= 1);
    RULE(t, "max_pool", x, size >= 1 && size < 128 && stride >= 1 && pad >= 0 && 2 * pad <= size);
    const int64_t H = x->dim[0] + 2 * pad - size, W = x->dim[1] + 2 * pad - size;
    RULE(t, "max_pool", x, H >= 0 && W >= 0 && x->dim[0] * x->dim[1] < INT32_MAX);
    tensor *y = tape_tensor(t, x->type, 3, (int64_t[]){H / stride + 1, W / stride + 1, x->dim[2]});
    NEED(y);
    pool_attr attr = {size, stride, pad};
    /* saved: for every output the pixel (row * W + column, I32) that was the maximum */
    const size_t saved = (size_t)tensor_count(y) * sizeof(int32_t);
    return tape_call(t, OP_max_pool, 1, &x, 1, &y, &attr, sizeof attr, saved) ? y : NULL;
}

tensor *op_average_pool(tape *t, tensor *x) {
    NEED(x);
    RULE(t, "average_pool", x, is_real(t, x) && x->rank >= 2 && tensor_rows(x) >= 1);
    tensor *y = tape_tensor(t, x->type, 1, &x->dim[x->rank - 1]);
    NEED(y);
    return tape_call(t, OP_average_pool, 1, &x, 1, &y, NULL, 0, 0) ? y : NULL;
}
