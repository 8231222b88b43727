/* batch_norm: one weight, bias and running statistic a channel of x, which keeps its shape. */
#include "tensor/ops/shape.h"

tensor *op_batch_norm(tape *t, tensor *x, tensor *weight, tensor *bias, tensor *running_mean,
                      tensor *running_var, float eps, float momentum, bool relu) {
    NEED(x);
    tensor *in[] = {x, weight, bias, running_mean, running_var};
    RULE(t, "batch_norm", x, is_real(t, x) && x->rank >= 1 && tensor_columns(x) >= 1);
    if (tape_settings(t).training) RULE(t, "batch_norm", x, tensor_rows(x) >= 1);
    for (int i = 1; i < 5; i++) {
        NEED(in[i]);
        RULE(t, "batch_norm", in[i], is_real(t, in[i]) && tensor_count(in[i]) == tensor_columns(x));
    }
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    batch_norm_attr attr = {eps, momentum, relu};
    /* saved: mean[C], 1 / standard deviation[C] as used; mean_rest[C]: what the mean's type could not hold */
    const size_t saved = 3 * (size_t)tensor_columns(x) * dtype_size(x->type);
    return tape_call(t, OP_batch_norm, 5, in, 1, &y, &attr, sizeof attr, saved) ? y : NULL;
}
