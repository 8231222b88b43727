/* The CUDA backend's own C++, which the kernel files share. Each op family is one file, as in cpu/; ref/
 * defines every op. There are a few idioms, all deterministic (no atomic additions of floats anywhere):
 * - each: one thread for each element
 * - each_row: one warp for each row, with lanes over its columns
 * - column_sums: sums over rows, in slabs of rows whose number depends only on the shape
 * - total: one sum of everything, in double
 * - product: matrix products (product.h)
 * - scatter: sums of rows that go to numbered places, by sorting (scatter.h)
 *
 * Kernels are lambdas passed to these, or plain __global__ functions. With CUDA_EMULATED everything here is
 * compiled as plain C++ and runs on the host by tests/support/cuda_emulated.*, which also gives the namespace
 * another name. */
#ifndef SHERF_CUDA_H
#define SHERF_CUDA_H

#include <math.h>

#include "tensor/block.h"
#include "tensor/tensor.h"

#ifdef CUDA_EMULATED
#include <cuda_emulated.h>
#else
#include <cuda_runtime.h>
#endif

namespace cuda_backend {

enum { WARP = 32, BLOCK = 256, ROWS_A_BLOCK = BLOCK / WARP };

/* ---- the host's side (runtime.cu, memory.cu) ---- */
/* The memory of all tensors of this backend. */
extern const tensor_memory device_memory;
extern const block_kernels block_arithmetic; /* blocks.cu */
extern const block_groups process_groups;    /* group.cu */
/* The first launch error since the last call, if any. Every function that launches kernels calls this last.
 */
sherf_status finished(context *c, const char *what);
inline sherf_status finished(op_call *call) {
    return finished(call->c, op_name(call->op));
}

#ifndef CUDA_EMULATED
cudaStream_t stream(); /* one for the process, so that work runs in the order of the calls */

template <typename... P, typename... A> void launch(void (*kernel)(P...), dim3 grid, dim3 block, A... args) {
    kernel<<<grid, block, 0, stream()>>>(args...);
}
#endif

/* Scratch until the op's end; NULL: out of memory, which the caller returns as SHERF_NO_MEMORY. */
template <typename T> T *scratch(op_call *call, int64_t count) {
    return (T *)arena_alloc(call->c, call->scratch, (size_t)count, sizeof(T));
}

inline float *values(const tensor *x) { /* NULL: missing */
    return x ? (float *)x->data : nullptr;
}
inline const int32_t *integers(const tensor *x) {
    return x ? (const int32_t *)x->data : nullptr;
}

inline int64_t divided_up(int64_t n, int64_t by) {
    return (n + by - 1) / by;
}

/* ---- one thread an element ---- */
template <typename F> __global__ void each_kernel(int64_t n, F f) {
    const int64_t step = (int64_t)gridDim.x * blockDim.x;
    for (int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x; i < n; i += step) f(i);
}

/* f(i) for 0 <= i < n. */
template <typename F> void each(int64_t n, F f) {
    const int64_t blocks = divided_up(n, BLOCK), max = 1 << 20;
    if (n > 0) launch(each_kernel<F>, dim3((unsigned)(blocks < max ? blocks : max)), dim3(BLOCK), n, f);
}

/* ---- one warp a row ---- */
#ifndef CUDA_EMULATED
__device__ inline float warp_sum(float v) { /* every lane gets it */
    for (int step = WARP / 2; step > 0; step /= 2) v += __shfl_xor_sync(0xffffffffu, v, step);
    return v;
}
#endif

template <typename F> __global__ void each_row_kernel(int64_t rows, F f) {
    const int64_t step = (int64_t)gridDim.x * ROWS_A_BLOCK;
    const int lane = (int)threadIdx.x % WARP;
    for (int64_t r = (int64_t)blockIdx.x * ROWS_A_BLOCK + threadIdx.x / WARP; r < rows; r += step) f(r, lane);
}

/* f(row, lane) by all 32 lanes of a warp together, so that f may use warp_sum. */
template <typename F> void each_row(int64_t rows, F f) {
    const int64_t blocks = divided_up(rows, ROWS_A_BLOCK), max = 1 << 20;
    if (rows > 0)
        launch(each_row_kernel<F>, dim3((unsigned)(blocks < max ? blocks : max)), dim3(BLOCK), rows, f);
}

/* ---- sums over rows ---- */
template <int K> struct several { float v[K]; };

enum { SLAB_THREADS = 8 };
constexpr int64_t slabs_max = 256, slab_rows_min = 64;

/* Block (x, y): columns 32 x .. 32 x + 31 of slab y of the rows. partial[slab][k][column]. */
template <int K, typename F>
__global__ void slab_sums_kernel(int64_t rows, int64_t columns, float *partial, F f) {
    __shared__ float part[K][SLAB_THREADS][WARP];
    const int64_t c = (int64_t)blockIdx.x * WARP + threadIdx.x;
    const int64_t begin = rows * blockIdx.y / gridDim.y, end = rows * (blockIdx.y + 1) / gridDim.y;
    several<K> sum = {};
    if (c < columns)
        for (int64_t r = begin + threadIdx.y; r < end; r += SLAB_THREADS) {
            const several<K> one = f(r, c);
            for (int k = 0; k < K; k++) sum.v[k] += one.v[k];
        }
    for (int k = 0; k < K; k++) part[k][threadIdx.y][threadIdx.x] = sum.v[k];
    __syncthreads();
    if (threadIdx.y != 0 || c >= columns) return;
    for (int k = 0; k < K; k++) {
        float all = 0;
        for (int i = 0; i < SLAB_THREADS; i++) all += part[k][i][threadIdx.x];
        partial[((int64_t)blockIdx.y * K + k) * columns + c] = all;
    }
}

/* g(c, sums over r of f(r, c)) for every column; K sums at once. */
template <int K, typename F, typename G>
sherf_status column_sums(op_call *call, int64_t rows, int64_t columns, F f, G g) {
    if (columns == 0) return SHERF_OK;
    int64_t slabs = divided_up(rows, slab_rows_min);
    slabs = slabs < 1 ? 1 : slabs > slabs_max ? slabs_max : slabs;
    float *partial = scratch<float>(call, slabs * K * columns);
    if (!partial) return SHERF_NO_MEMORY;
    launch(slab_sums_kernel<K, F>, dim3((unsigned)divided_up(columns, WARP), (unsigned)slabs),
           dim3(WARP, SLAB_THREADS), rows, columns, partial, f);
    each(columns, [=] __device__(int64_t c) {
        several<K> sum = {};
        for (int64_t s = 0; s < slabs; s++)
            for (int k = 0; k < K; k++) sum.v[k] += partial[(s * K + k) * columns + c];
        g(c, sum);
    });
    return SHERF_OK;
}

/* ---- one sum ---- */
constexpr int64_t parts_max = 1024;

template <typename F> __global__ void parts_kernel(int64_t n, double *partial, F f) {
    __shared__ double part[BLOCK];
    const int64_t begin = n * blockIdx.x / gridDim.x, end = n * (blockIdx.x + 1) / gridDim.x;
    double sum = 0;
    for (int64_t i = begin + threadIdx.x; i < end; i += BLOCK) sum += f(i);
    part[threadIdx.x] = sum;
    for (int step = BLOCK / 2; step > 0; step /= 2) {
        __syncthreads();
        if ((int)threadIdx.x < step) part[threadIdx.x] += part[threadIdx.x + step];
    }
    if (threadIdx.x == 0) partial[blockIdx.x] = part[0];
}

/* g(sum over i < n of f(i)), which is a double. */
template <typename F, typename G> sherf_status total(op_call *call, int64_t n, F f, G g) {
    int64_t parts = divided_up(n, 4 * BLOCK);
    parts = parts < 1 ? 1 : parts > parts_max ? parts_max : parts;
    double *partial = scratch<double>(call, parts);
    if (!partial) return SHERF_NO_MEMORY;
    launch(parts_kernel<F>, dim3((unsigned)parts), dim3(BLOCK), n, partial, f);
    each(1, [=] __device__(int64_t) {
        double sum = 0;
        for (int64_t p = 0; p < parts; p++) sum += partial[p];
        g(sum);
    });
    return SHERF_OK;
}

/* ---- the ops ---- */
#define CUDA_BOTH(op)                                                                                        \
    sherf_status op##_forward(op_call *call);                                                                \
    sherf_status op##_backward(op_call *call);
#define CUDA_FORWARD(op) sherf_status op##_forward(op_call *call);
OPS(CUDA_BOTH, CUDA_FORWARD, CUDA_BOTH)
#undef CUDA_BOTH
#undef CUDA_FORWARD

} // namespace cuda_backend
#endif
