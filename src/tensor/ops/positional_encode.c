/* positional_encode: x and its sines at doubling frequencies, cut to a width. */
#include "tensor/ops/shape.h"

tensor *op_positional_encode(tape *t, tensor *x, int frequencies, int64_t width) {
    NEED(x);
    RULE(t, "positional_encode", x, is_real(t, x) && x->rank >= 1 && frequencies >= 0 && frequencies <= 24);
    RULE(t, "positional_encode", x, width > 0 && width <= tensor_columns(x) * (1 + 2 * (int64_t)frequencies));
    tensor *y = with_columns(t, x, width);
    NEED(y);
    encode_attr attr = {frequencies, width};
    return tape_call(t, OP_positional_encode, 1, &x, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
