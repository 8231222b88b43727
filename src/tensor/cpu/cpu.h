/* The CPU backend: oneDNN, SIMD and OpenMP kernels that compute the same as the reference's. */
#ifndef SHERF_CPU_H
#define SHERF_CPU_H

#include "tensor/tensor.h"

#define CPU_FORWARD(op) sherf_status cpu_##op##_forward(op_call *call);
#define CPU_BOTH(op) CPU_FORWARD(op) sherf_status cpu_##op##_backward(op_call *call);
#define CPU_SHARED(op) /* ref/ref.h */
OPS(CPU_BOTH, CPU_FORWARD, CPU_SHARED)
#undef CPU_FORWARD
#undef CPU_BOTH
#undef CPU_SHARED
#endif
