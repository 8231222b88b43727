/* composite: the kept samples of N rays to [N, 5]: colour, opacity, depth. */
#include "tensor/ops/shape.h"

tensor *op_composite(tape *t, tensor *sigma, tensor *rgb, tensor *first, tensor *sample, tensor *near,
                     tensor *far, tensor *length, tensor *at, composite_attr attr) {
    NEED(sigma);
    NEED(rgb);
    NEED(first);
    NEED(sample);
    NEED(near);
    NEED(far);
    NEED(length);
    const int64_t points = tensor_count(sigma), rays = tensor_count(first) - 1;
    RULE(t, "composite", sigma, is_real(t, sigma) && attr.samples >= 2);
    RULE(t, "composite", rgb, is_real(t, rgb) && rgb->rank == 2 && rgb->dim[0] == points && rgb->dim[1] == 3);
    RULE(t, "composite", first, first->type == T_I32 && rays >= 0);
    RULE(t, "composite", sample, sample->type == T_I32 && tensor_count(sample) == points);
    RULE(t, "composite", near, is_real(t, near) && tensor_count(near) == rays);
    RULE(t, "composite", far, is_real(t, far) && tensor_count(far) == rays);
    RULE(t, "composite", length, is_real(t, length) && tensor_count(length) == rays);
    RULE(t, "composite", at,
         !at || (is_real(t, at) && at->rank == 2 && at->dim[0] == points && at->dim[1] == 2));
    tensor *y = tape_tensor(t, sigma->type, 2, (int64_t[]){rays, 5});
    NEED(y);
    tensor *in[] = {sigma, rgb, first, sample, near, far, length, at};
    return tape_call(t, OP_composite, (int)COUNT_OF(in), in, 1, &y, &attr, sizeof attr, 0) ? y : NULL;
}
