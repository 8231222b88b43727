/* feature_distance: two feature maps of one shape to a scalar, weighted by channel where there is a head. */
#include "tensor/ops/shape.h"

tensor *op_feature_distance(tape *t, tensor *a, tensor *b, tensor *head) {
    NEED(a);
    NEED(b);
    RULE(t, "feature_distance", a, is_real(t, a) && a->rank >= 1 && tensor_count(a) > 0);
    RULE(t, "feature_distance", b, is_real(t, b) && tensor_same_shape(a, b));
    if (head) RULE(t, "feature_distance", head, is_real(t, head) && tensor_count(head) == tensor_columns(a));
    tensor *mean = tape_tensor(t, a->type, 1, (int64_t[]){1});
    NEED(mean);
    return tape_call(t, OP_feature_distance, 3, (tensor *[]){a, b, head}, 1, &mean, NULL, 0, 0) ? mean : NULL;
}
