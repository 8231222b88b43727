/* The reference: one file for each family of ops, with their shape rules (rules.c) and their kernels in plain
 * C. An op's backward rule stands right below its forward rule. The kernels are compiled twice (ref_f32.c,
 * ref_f64.c) with `real` and the name suffix set. Clarity before speed: they define the ops. */
#ifndef SHERF_REF_H
#define SHERF_REF_H

#include "tensor/tensor.h"

#define REF_NAME_(name, suffix) ref_##name##_##suffix
#define REF_NAME(name, suffix) REF_NAME_(name, suffix)

#define REF_FORWARD(op)                                                                                      \
    sherf_status ref_##op##_forward_f32(op_call *call);                                                      \
    sherf_status ref_##op##_forward_f64(op_call *call);
#define REF_BOTH(op)                                                                                         \
    REF_FORWARD(op)                                                                                          \
    sherf_status ref_##op##_backward_f32(op_call *call);                                                     \
    sherf_status ref_##op##_backward_f64(op_call *call);
OPS(REF_BOTH, REF_FORWARD, REF_BOTH)
#undef REF_BOTH
#undef REF_FORWARD
#endif
