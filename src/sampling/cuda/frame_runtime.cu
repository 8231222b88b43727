/* Functions of the CUDA runtime for frames, in addition to the tensors' memory. */
#include "sampling/cuda/warp.h"

namespace cuda_backend {

sherf_status finished_work(context *c, const char *what) {
    const cudaError_t code = cudaGetLastError();
    if (code == cudaSuccess) return SHERF_OK;
    return failure(c, SHERF_UNSUPPORTED, "%s: CUDA says: %s", what, cudaGetErrorString(code));
}

int multiprocessors() {
    int device = 0, count = 1;
    cudaGetDevice(&device);
    cudaDeviceGetAttribute(&count, cudaDevAttrMultiProcessorCount, device);
    return count;
}

void *pinned_take(context *c, size_t bytes) {
    void *p = nullptr;
    if (cudaMallocHost(&p, bytes) == cudaSuccess) return p;
    cudaGetLastError(); /* clears the error */
    failure(c, SHERF_NO_MEMORY, "out of memory: %.1f MB that the GPU can copy to were requested",
            (double)bytes / 1e6);
    return nullptr;
}

void pinned_give(void *p) {
    if (p) cudaFreeHost(p);
}

} // namespace cuda_backend
