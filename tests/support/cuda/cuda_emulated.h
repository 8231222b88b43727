/* CUDA's language on the host, for the kernels of src/tensor/cuda compiled as plain C++. Threads of a block
 * are fibres that change at barriers; blocks run one after another. It finds wrong indices, missing barriers
 * (threads and blocks run in both orders) and host code that reads the device's memory (which is locked
 * between ops). It proves nothing about a GPU. */
#ifndef CUDA_EMULATED_H
#define CUDA_EMULATED_H

#include <functional>
#include <stddef.h>

#define __global__
#define __device__
#define __host__
#define __shared__ static

struct dim3 {
    unsigned x, y, z;
    dim3(unsigned width = 1, unsigned height = 1, unsigned depth = 1) : x(width), y(height), z(depth) {}
};
extern dim3 threadIdx, blockIdx, blockDim, gridDim;

void __syncthreads();

namespace cuda_backend {

/* The sum over the 32 lanes of a warp, in the order of the shuffles on a GPU. All of them must call it. */
float warp_sum(float v);

/* Runs the body once for every thread. */
void emulate(dim3 grid, dim3 block, const std::function<void()> &body);

template <typename... P, typename... A> void launch(void (*kernel)(P...), dim3 grid, dim3 block, A... args) {
    emulate(grid, block, [&] { kernel(args...); });
}

} // namespace cuda_backend

/* 0: threads and blocks in ascending order; 1: descending. For tests. */
extern "C" int cuda_emulated_order;

#endif
