/* concat, slice: columns put side by side, and a run of them taken out. */
#include "tensor/ops/shape.h"

tensor *op_concat(tape *t, int count, tensor *const *x) {
    int64_t columns = 0;
    for (int i = 0; i < count; i++) NEED(x[i]);
    NEED(count > 0);
    RULE(t, "concat", x[0], count >= 2 && count <= 4);
    for (int i = 0; i < count; i++) {
        RULE(t, "concat", x[i],
             is_real(t, x[i]) && x[i]->rank >= 1 && tensor_rows(x[i]) == tensor_rows(x[0]));
        columns += tensor_columns(x[i]);
    }
    tensor *y = with_columns(t, x[0], columns);
    NEED(y);
    return tape_call(t, OP_concat, count, x, 1, &y, NULL, 0, 0) ? y : NULL;
}

tensor *op_slice(tape *t, tensor *x, int64_t begin, int64_t width) {
    NEED(x);
    RULE(t, "slice", x, is_real(t, x) && x->rank >= 1);
    RULE(t, "slice", x, begin >= 0 && width >= 1 && begin <= tensor_columns(x) - width);
    tensor *y = with_columns(t, x, width);
    NEED(y);
    slice_attr attr = {begin, width};
    return tape_call(t, OP_slice, 1, &x, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
