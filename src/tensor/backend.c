/* Chooses the table of kernels for a context. Tests can replace the GPU's. */
#include "tensor/tensor.h"

#ifdef SHERF_HAVE_CUDA
static const backend *gpu = &backend_cuda;
#else
static const backend *gpu; /* no context has such a device */
#endif

const backend *backend_of(const context *c) {
    return c->device == SHERF_DEVICE_CUDA ? gpu : &backend_cpu;
}

void backend_stand_in(const backend *b) {
    gpu = b;
}
