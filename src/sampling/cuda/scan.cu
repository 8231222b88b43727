/* Prefix sums in three passes: sums of blocks, prefix sums of these, and each block again. */
#include "sampling/cuda/frame.h"

namespace cuda_backend {

static __device__ int64_t scan_end(int64_t n, const int32_t *counted) {
    return counted && *counted < n ? *counted : n;
}

/* v: this thread's sum. Returns the sum of those before it in the block; *all: the block's sum. */
static __device__ int32_t block_before(int32_t v, int32_t *all) {
    __shared__ int32_t warp_total[ROWS_A_BLOCK];
    const int warp = (int)threadIdx.x / WARP;
    int32_t before = warp_before(v), total = 0;
    if (threadIdx.x % WARP == WARP - 1) warp_total[warp] = before + v;
    __syncthreads();
    for (int w = 0; w < ROWS_A_BLOCK; w++) {
        if (w == warp) before += total;
        total += warp_total[w];
    }
    __syncthreads();
    *all = total;
    return before;
}

static __device__ int32_t run_sum(int64_t begin, int64_t end, const int32_t *value) {
    int32_t sum = 0;
    for (int64_t i = begin; i < begin + SCAN_RUN && i < end; i++) sum += value[i];
    return sum;
}

__global__ static void scan_sums_kernel(int64_t n, const int32_t *counted, const int32_t *value,
                                        int32_t *sums) {
    const int64_t end = scan_end(n, counted), first = (int64_t)blockIdx.x * SCAN_BLOCK;
    if (first >= end) { /* the whole block */
        if (threadIdx.x == 0) sums[blockIdx.x] = 0;
        return;
    }
    int32_t all;
    block_before(run_sum(first + (int64_t)threadIdx.x * SCAN_RUN, end, value), &all);
    if (threadIdx.x == 0) sums[blockIdx.x] = all;
}

/* The sums before each block, by one block; sums[blocks] is the total. */
__global__ static void scan_blocks_kernel(int64_t blocks, int32_t *sums) {
    const int64_t begin = blocks * threadIdx.x / BLOCK, end = blocks * (threadIdx.x + 1) / BLOCK;
    int32_t sum = 0, all;
    for (int64_t i = begin; i < end; i++) sum += sums[i];
    sum = block_before(sum, &all);
    for (int64_t i = begin; i < end; i++) {
        const int32_t one = sums[i];
        sums[i] = sum;
        sum += one;
    }
    if (threadIdx.x == 0) sums[blocks] = all;
}

__global__ static void scan_write_kernel(int64_t n, const int32_t *counted, int32_t *value,
                                         const int32_t *sums) {
    const int64_t end = scan_end(n, counted), first = (int64_t)blockIdx.x * SCAN_BLOCK;
    if (blockIdx.x == 0 && threadIdx.x == 0) value[end] = sums[gridDim.x]; /* nobody else's */
    if (first >= end) return;
    const int64_t begin = first + (int64_t)threadIdx.x * SCAN_RUN;
    int32_t all, sum = sums[blockIdx.x] + block_before(run_sum(begin, end, value), &all);
    for (int64_t i = begin; i < begin + SCAN_RUN && i < end; i++) {
        const int32_t one = value[i];
        value[i] = sum;
        sum += one;
    }
}

void scan(int64_t n, const int32_t *counted, int32_t *value, int32_t *sums) {
    const int64_t blocks = n > 0 ? divided_up(n, SCAN_BLOCK) : 1;
    const dim3 grid((unsigned)blocks), block(BLOCK);
    launch(scan_sums_kernel, grid, block, n, counted, (const int32_t *)value, sums);
    launch(scan_blocks_kernel, dim3(1), block, blocks, sums);
    launch(scan_write_kernel, grid, block, n, counted, value, (const int32_t *)sums);
}

} // namespace cuda_backend
