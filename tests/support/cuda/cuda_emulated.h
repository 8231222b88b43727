/* CUDA's language emulated on the host, for the kernels of src/tensor/cuda compiled as plain C++. The threads
 * of a block are fibres that switch at barriers; blocks run one after another. It finds wrong indices,
 * missing barriers (threads and blocks run in both orders) and host code that reads the device's memory
 * (which is locked between ops). It proves nothing about a GPU. */
#ifndef CUDA_EMULATED_H
#define CUDA_EMULATED_H

#include <functional>
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define __global__
#define __device__
#define __host__
#define __shared__ static

struct dim3 {
    unsigned x, y, z;
    dim3(unsigned width = 1, unsigned height = 1, unsigned depth = 1) : x(width), y(height), z(depth) {}
};
extern dim3 threadIdx, blockIdx, blockDim, gridDim;

struct alignas(16) float4 {
    float x, y, z, w;
};
struct alignas(16) uint4 {
    uint32_t x, y, z, w;
};
struct alignas(8) uint2 {
    uint32_t x, y;
};
inline float4 make_float4(float x, float y, float z, float w) {
    return {x, y, z, w};
}
inline uint4 make_uint4(uint32_t x, uint32_t y, uint32_t z, uint32_t w) {
    return {x, y, z, w};
}

void __syncthreads();
int atomicAdd(int *to, int v);
#define __launch_bounds__(...)
#define UNROLL

namespace cuda_backend {

/* The sum over the 32 lanes of a warp, in the order of a GPU's shuffles. All lanes must call it. */
float warp_sum(float v);

/* The functions that src/sampling/cuda/warp.h has for a GPU. */
float quad_sum(float v);
int32_t warp_before(int32_t v);
int bits_set(uint32_t bits);
uint32_t warp_ballot(bool v);
void warp_barrier();
uint32_t transpose8(uint32_t v);
void mma_bf16(float c[4], const uint32_t a[4], const uint32_t b[2]);
uint32_t pack_bf16(float low, float high);
float unpack_bf16(uint32_t pair, int high);
float half_value(uint16_t half);
uint16_t half_of(float v);
void async_copy(void *shared, const void *global);
void async_commit();
void async_wait_but(int newest);

/* Runs the body once for every thread. */
void emulate(dim3 grid, dim3 block, const std::function<void()> &body);

template <typename... P, typename... A> void launch(void (*kernel)(P...), dim3 grid, dim3 block, A... args) {
    emulate(grid, block, [&] { kernel(args...); });
}
template <typename... P, typename... A>
void launch_wide(void (*kernel)(P...), dim3 grid, dim3 block, size_t shared_bytes, A... args) {
    emulate(grid, block, [&] { kernel(args...); });
}
/* Shared memory of more than 48 KB. */
#define WIDE_SHARED(name, bytes) static unsigned char name[bytes] __attribute__((aligned(128)))

} // namespace cuda_backend

/* 0: threads and blocks in ascending order; 1: descending. For tests. */
extern "C" int cuda_emulated_order;
/* The size of the device's memory; 0: no limit. */
extern "C" size_t cuda_emulated_bytes;

#endif
