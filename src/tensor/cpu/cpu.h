/* The CPU backend: oneDNN, SIMD and OpenMP kernels with the reference kernels' meaning. */
#ifndef SHERF_CPU_H
#define SHERF_CPU_H

#include "tensor/ops.h"

/* CPU_KERNEL(op): its own forward and backward; CPU_FORWARD(op): no backward; CPU_SHARED(op),
 * CPU_SHARED_FORWARD(op): the reference's own float32 kernels, fast enough where the op is small. */
#define CPU_KERNEL(op)                                                                                       \
    sherf_status cpu_##op##_forward(op_call *call);                                                          \
    sherf_status cpu_##op##_backward(op_call *call);
#define CPU_FORWARD(op) sherf_status cpu_##op##_forward(op_call *call);
#define CPU_SHARED(op)
#define CPU_SHARED_FORWARD(op)
#include "tensor/cpu/dense_list.h"
#include "tensor/cpu/spatial_list.h"
#undef CPU_KERNEL
#undef CPU_FORWARD
#undef CPU_SHARED
#undef CPU_SHARED_FORWARD
#endif
