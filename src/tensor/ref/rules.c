/* The ops' shape rules and their steps on the tape: the first parts of dense.inc's and spatial.inc's files.
 */
#include "tensor/tensor.h"

#define RULES
/* Returns from the op if an input is missing (an earlier op failed) or the rule does not hold. */
#define NEED(x)                                                                                              \
    do {                                                                                                     \
        if (!(x)) return NULL;                                                                               \
    } while (0)
#define RULE(t, op, x, holds)                                                                                \
    do {                                                                                                     \
        if (!(holds)) {                                                                                      \
            char shape_[64];                                                                                 \
            tensor_shape_text(x, shape_);                                                                    \
            return tape_fail(t, SHERF_BAD_ARGUMENT, "%s: shape %s does not fit: %s", op, shape_, #holds);    \
        }                                                                                                    \
    } while (0)

static inline dtype real_type(tape *t) {
    return tape_backend(t)->real;
}
static inline bool is_real(tape *t, const tensor *x) {
    return x->type == real_type(t);
}
/* A new tensor like x, but with another last dimension. */
static inline tensor *with_columns(tape *t, const tensor *x, int64_t columns) {
    int64_t dim[TENSOR_RANK] = {0};
    for (int i = 0; i < x->rank; i++) dim[i] = x->dim[i];
    dim[x->rank ? x->rank - 1 : 0] = columns;
    return tape_tensor(t, x->type, x->rank ? x->rank : 1, dim);
}

#include "tensor/ref/dense.inc"
#include "tensor/ref/spatial.inc"
