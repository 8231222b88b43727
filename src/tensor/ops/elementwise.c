/* bias_act, add, scale, mask_rows, shift_scale: every value of the output depends on one of each input. */
#include "tensor/ops/shape.h"

tensor *op_bias_act(tape *t, tensor *x, tensor *b, float slope, float gain, float clamp) {
    NEED(x);
    RULE(t, "bias_act", x, is_real(t, x) && clamp >= 0);
    if (b) RULE(t, "bias_act", b, is_real(t, b) && tensor_count(b) == tensor_columns(x));
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    bias_act_attr attr = {slope, gain, clamp};
    return tape_call(t, OP_bias_act, 2, (tensor *[]){x, b}, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}

tensor *op_add(tape *t, tensor *a, tensor *b) {
    NEED(a);
    NEED(b);
    RULE(t, "add", a, is_real(t, a));
    RULE(t, "add", b, is_real(t, b) && tensor_same_shape(a, b));
    tensor *y = tape_tensor(t, a->type, a->rank, a->dim);
    NEED(y);
    return tape_call(t, OP_add, 2, (tensor *[]){a, b}, 1, &y, NULL, 0, 0) ? y : NULL;
}

tensor *op_scale(tape *t, tensor *x, float factor) {
    NEED(x);
    RULE(t, "scale", x, is_real(t, x));
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    return tape_call(t, OP_scale, 1, &x, 1, &y, &factor, sizeof factor, 0) ? y : NULL;
}

tensor *op_mask_rows(tape *t, tensor *x, tensor *mask) {
    NEED(x);
    NEED(mask);
    RULE(t, "mask_rows", x, is_real(t, x) && x->rank >= 1);
    RULE(t, "mask_rows", mask, mask->type == T_I32 && tensor_count(mask) == tensor_rows(x));
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    return tape_call(t, OP_mask_rows, 2, (tensor *[]){x, mask}, 1, &y, NULL, 0, 0) ? y : NULL;
}

tensor *op_shift_scale(tape *t, tensor *x, const shift_scale_attr *attr) {
    NEED(x);
    const bool crop = attr->width > 0;
    RULE(t, "shift_scale", x, is_real(t, x) && x->rank >= 1 && tensor_columns(x) <= 4);
    if (crop) {
        RULE(t, "shift_scale", x, x->rank == 3 && attr->height >= 1 && attr->left >= 0 && attr->top >= 0);
        RULE(t, "shift_scale", x, attr->left <= x->dim[1] && attr->width <= x->dim[1] - attr->left);
        RULE(t, "shift_scale", x, attr->top <= x->dim[0] && attr->height <= x->dim[0] - attr->top);
    }
    tensor *y =
        tape_tensor(t, x->type, x->rank,
                    crop ? (int64_t[]){attr->height, attr->width, x->dim[2]} : (const int64_t *)x->dim);
    NEED(y);
    return tape_call(t, OP_shift_scale, 1, &x, 1, &y, attr, sizeof *attr, 0) ? y : NULL;
}
