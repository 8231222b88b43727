/* The CUDA runtime behind the tensors' memory: one stream, allocation, copies, errors. */
#include <stdio.h>

#include "tensor/cuda/cuda.h"

namespace cuda_backend {

static cudaStream_t stream_make() {
    cudaStream_t s = nullptr;
    cudaStreamCreateWithFlags(&s, cudaStreamNonBlocking); /* fails where everything after it does, too */
    return s;
}

cudaStream_t stream() {
    static cudaStream_t s = stream_make();
    return s;
}

static sherf_status checked(context *c, const char *what, cudaError_t code) {
    if (code == cudaSuccess) return SHERF_OK;
    return failure(c, SHERF_UNSUPPORTED, "%s: CUDA says: %s", what, cudaGetErrorString(code));
}

sherf_status finished(op_call *call) {
    return checked(call->c, op_name(call->op), cudaGetLastError());
}

static void *take(context *c, size_t bytes) {
    void *p = nullptr;
    if (cudaMalloc(&p, bytes) == cudaSuccess) return p;
    size_t free_bytes = 0, all_bytes = 0;
    cudaGetLastError(); /* forgets it */
    cudaMemGetInfo(&free_bytes, &all_bytes);
    failure(c, SHERF_NO_MEMORY, "out of GPU memory: %.1f MB asked for, %.1f of %.1f MB are free",
            (double)bytes / 1e6, (double)free_bytes / 1e6, (double)all_bytes / 1e6);
    return nullptr;
}

static void give(void *p) {
    cudaFree(p);
}

/* Both wait: the caller's memory may change or be read behind them, and where a GPU reaches the host's pages
 * by itself an asynchronous copy need not have taken it yet. */
static sherf_status moved(context *c, const char *what, void *to, const void *from, size_t bytes,
                          cudaMemcpyKind kind) {
    cudaError_t code = cudaMemcpyAsync(to, from, bytes, kind, stream());
    if (code == cudaSuccess) code = cudaStreamSynchronize(stream());
    return checked(c, what, code);
}

static sherf_status upload(context *c, void *to, const void *from, size_t bytes) {
    return moved(c, "copying to the GPU", to, from, bytes, cudaMemcpyHostToDevice);
}

static sherf_status download(context *c, void *to, const void *from, size_t bytes) {
    return moved(c, "copying from the GPU", to, from, bytes, cudaMemcpyDeviceToHost);
}

static sherf_status copy(context *c, void *to, const void *from, size_t bytes) {
    return checked(c, "copying on the GPU",
                   cudaMemcpyAsync(to, from, bytes, cudaMemcpyDeviceToDevice, stream()));
}

static sherf_status clear(context *c, void *to, size_t bytes) {
    return checked(c, "clearing on the GPU", cudaMemsetAsync(to, 0, bytes, stream()));
}

const tensor_memory device_memory = {"CUDA", {take, give}, upload, download, copy, clear};

} // namespace cuda_backend
