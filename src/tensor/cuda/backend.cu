/* The CUDA backend's table, made from kernel_list.h. */
#include "tensor/cuda/cuda.h"

static backend table() {
    backend b = {};
    b.name = "CUDA";
    b.real = T_F32;
    b.memory = &cuda_backend::device_memory;
#define CUDA_FORWARD(op) b.forward[OP_##op] = cuda_backend::op##_forward;
#define CUDA_KERNEL(op)                                                                                      \
    CUDA_FORWARD(op)                                                                                         \
    b.backward[OP_##op] = cuda_backend::op##_backward;
#include "tensor/cuda/kernel_list.h"
#undef CUDA_KERNEL
#undef CUDA_FORWARD
    return b;
}

const backend backend_cuda = table();
