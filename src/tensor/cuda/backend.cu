/* The CUDA backend's table, made from the list in ops.h. */
#include "tensor/cuda/cuda.h"

static backend table() {
    backend b = {};
    b.name = "CUDA";
    b.real = T_F32;
    b.memory = &cuda_backend::device_memory;
#define CUDA_FORWARD(op) b.forward[OP_##op] = cuda_backend::op##_forward;
#define CUDA_BOTH(op)                                                                                        \
    CUDA_FORWARD(op)                                                                                         \
    b.backward[OP_##op] = cuda_backend::op##_backward;
    OPS(CUDA_BOTH, CUDA_FORWARD, CUDA_BOTH)
#undef CUDA_BOTH
#undef CUDA_FORWARD
    return b;
}

const backend backend_cuda = table();
