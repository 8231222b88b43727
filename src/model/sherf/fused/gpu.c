/* Which device makes a context's frames. */
#include "model/sherf/fused/gpu.h"

static const gpu_renderer *stand_in;

void gpu_renderer_stand_in(const gpu_renderer *r) {
    stand_in = r;
}

const gpu_renderer *gpu_renderer_of(const context *c) {
    if (c->device != SHERF_DEVICE_CUDA) return NULL;
    if (stand_in) return stand_in;
#ifdef SHERF_HAVE_CUDA
    return &gpu_renderer_cuda;
#else
    return NULL; /* contexts of a GPU exist only in builds with one */
#endif
}
