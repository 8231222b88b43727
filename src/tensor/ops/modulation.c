/* demodulation, scale_channels, normalize_moment: what StyleGAN2 does with styles and its latent. */
#include "tensor/ops/shape.h"

tensor *op_demodulation(tape *t, tensor *w, tensor *s) {
    NEED(w);
    NEED(s);
    RULE(t, "demodulation", w, is_real(t, w) && w->rank == 4);
    RULE(t, "demodulation", s, is_real(t, s) && tensor_count(s) == w->dim[1]);
    tensor *d = tape_tensor(t, w->type, 1, w->dim);
    NEED(d);
    return tape_call(t, OP_demodulation, 2, (tensor *[]){w, s}, 1, &d, NULL, 0, 0) ? d : NULL;
}

tensor *op_scale_channels(tape *t, tensor *x, tensor *s) {
    NEED(x);
    NEED(s);
    RULE(t, "scale_channels", x, is_real(t, x) && x->rank >= 1);
    RULE(t, "scale_channels", s, is_real(t, s) && tensor_count(s) == tensor_columns(x));
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    return tape_call(t, OP_scale_channels, 2, (tensor *[]){x, s}, 1, &y, NULL, 0, 0) ? y : NULL;
}

tensor *op_normalize_moment(tape *t, tensor *x) {
    NEED(x);
    RULE(t, "normalize_moment", x, is_real(t, x) && x->rank >= 1 && tensor_columns(x) >= 1);
    tensor *y = tape_tensor(t, x->type, x->rank, x->dim);
    NEED(y);
    return tape_call(t, OP_normalize_moment, 1, &x, 1, &y, NULL, 0, 0) ? y : NULL;
}
