/* The CUDA runtime: this process's GPU and its one stream, memory, copies, errors. */
#include <stdio.h>

#include "base/device.h"
#include "tensor/cuda/memory.h"

namespace cuda_backend {

/* The GPU is a per-thread setting, so every thread that comes here sets it. */
static void choose() {
    static thread_local const bool chosen = cudaSetDevice(device_gpu_number()) == cudaSuccess;
    (void)chosen; /* if this fails, everything after it fails too */
}

static cudaStream_t stream_make() {
    cudaStream_t s = nullptr;
    cudaStreamCreateWithFlags(&s, cudaStreamNonBlocking);
    return s;
}

cudaStream_t stream() {
    choose();
    static cudaStream_t s = stream_make();
    return s;
}

static sherf_status checked(context *c, const char *what, cudaError_t code) {
    if (code == cudaSuccess) return SHERF_OK;
    return failure(c, SHERF_UNSUPPORTED, "%s: CUDA says: %s", what, cudaGetErrorString(code));
}

sherf_status finished(context *c, const char *what) {
    return checked(c, what, cudaGetLastError());
}

void *device_take(context *c, size_t bytes) {
    void *p = nullptr;
    choose();
    const cudaError_t code = cudaMalloc(&p, bytes);
    if (code == cudaSuccess) return p;
    cudaGetLastError(); /* clears the error */
    size_t free_bytes = 0, all_bytes = 0;
    if (code != cudaErrorMemoryAllocation || cudaMemGetInfo(&free_bytes, &all_bytes) != cudaSuccess)
        failure(c, SHERF_NO_MEMORY, "GPU memory, %.1f MB: CUDA says: %s", (double)bytes / 1e6,
                cudaGetErrorString(code));
    else
        failure(c, SHERF_NO_MEMORY, "out of GPU memory: %.1f MB requested, %.1f of %.1f MB are free",
                (double)bytes / 1e6, (double)free_bytes / 1e6, (double)all_bytes / 1e6);
    return nullptr;
}

void device_give(void *p) {
    choose();
    cudaFree(p); /* waits for pending work that uses it */
}

void *pinned_take(size_t bytes) {
    void *p = nullptr;
    choose();
    if (cudaHostAlloc(&p, bytes, cudaHostAllocDefault) == cudaSuccess) return p;
    cudaGetLastError();
    return nullptr;
}

sherf_status copy_begin(context *c, copy_way way, void *to, const void *from, size_t bytes) {
    static const cudaMemcpyKind kinds[] = {cudaMemcpyHostToDevice, cudaMemcpyDeviceToHost,
                                           cudaMemcpyDeviceToDevice};
    static const char *const names[] = {"copying to the GPU", "copying from the GPU", "copying on the GPU"};
    return checked(c, names[way], cudaMemcpyAsync(to, from, bytes, kinds[way], stream()));
}

sherf_status clear_begin(context *c, void *to, size_t bytes) {
    return checked(c, "clearing on the GPU", cudaMemsetAsync(to, 0, bytes, stream()));
}

sherf_status wait_for_all(context *c) {
    return checked(c, "waiting for the GPU", cudaStreamSynchronize(stream()));
}

mark *mark_make() {
    cudaEvent_t e = nullptr;
    choose();
    if (cudaEventCreateWithFlags(&e, cudaEventDisableTiming) == cudaSuccess) return (mark *)e;
    cudaGetLastError();
    return nullptr;
}

void mark_set(mark *place) {
    cudaEventRecord((cudaEvent_t)place, stream());
}

void mark_wait(mark *place) {
    cudaEventSynchronize((cudaEvent_t)place);
}

} // namespace cuda_backend
