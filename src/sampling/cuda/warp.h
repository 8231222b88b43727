/* Hardware functions for the kernels of frames beyond plain CUDA C++: exchange between the lanes of a warp,
 * tensor cores, asynchronous copies into shared memory, shared memory of more than 48 KB. The emulation has
 * the same functions (tests/support/cuda). All lanes of a warp must call those that say so. */
#ifndef SHERF_CUDA_WARP_H
#define SHERF_CUDA_WARP_H

#include "tensor/cuda/cuda.h"

#ifndef CUDA_EMULATED
#include <cuda_bf16.h>
#include <cuda_fp16.h>

namespace cuda_backend {

#define UNROLL _Pragma("unroll")

constexpr unsigned all_lanes = 0xffffffffu;

/* The whole warp: bit l is lane l's v. */
__device__ inline uint32_t warp_ballot(bool v) {
    return __ballot_sync(all_lanes, v);
}

/* The whole warp: the sum of the v of all lanes before this one. */
__device__ inline int32_t warp_before(int32_t v) {
    const int lane = (int)threadIdx.x % WARP;
    int32_t sum = v;
    for (int step = 1; step < WARP; step *= 2) {
        const int32_t other = __shfl_up_sync(all_lanes, sum, step);
        if (lane >= step) sum += other;
    }
    return sum - v;
}

__device__ inline int bits_set(uint32_t bits) {
    return __popc(bits);
}

/* The whole warp: the sum over lanes 4 q .. 4 q + 3, the same bits for each of them. */
__device__ inline float quad_sum(float v) {
    v += __shfl_xor_sync(all_lanes, v, 1);
    return v + __shfl_xor_sync(all_lanes, v, 2);
}

/* The whole warp: everything that any lane wrote to shared memory before is visible to all. */
__device__ inline void warp_barrier() {
    __syncwarp();
}

/* The whole warp: c += a b, 16 x 16 times 16 x 8, bf16 with sums in float32 (mma.sync.m16n8k16, 8.0 and
 * newer). With g = lane / 4 and t = lane % 4: a[0] row g, a[1] row g + 8 of columns 2 t, 2 t + 1; a[2], a[3]
 * the same 8 columns on. b[0] rows 2 t, 2 t + 1 of column g; b[1] 8 rows on. c[0], c[1] columns 2 t, 2 t + 1
 * of row g; c[2], c[3] of row g + 8. So two neighbouring c are one a of the next product, and layers follow
 * each other without leaving the registers. */
__device__ inline void mma_bf16(float c[4], const uint32_t a[4], const uint32_t b[2]) {
    asm volatile("mma.sync.aligned.m16n8k16.row.col.f32.bf16.bf16.f32 {%0,%1,%2,%3}, {%4,%5,%6,%7}, {%8,%9}, "
                 "{%0,%1,%2,%3};"
                 : "+f"(c[0]), "+f"(c[1]), "+f"(c[2]), "+f"(c[3])
                 : "r"(a[0]), "r"(a[1]), "r"(a[2]), "r"(a[3]), "r"(b[0]), "r"(b[1]));
}

/* The whole warp: an 8 x 8 matrix of 16-bit values, lane 4 g + t holding columns 2 t, 2 t + 1 of row g,
 * transposed. */
__device__ inline uint32_t transpose8(uint32_t v) {
    uint32_t out;
    asm volatile("movmatrix.sync.aligned.m8n8.trans.b16 %0, %1;" : "=r"(out) : "r"(v));
    return out;
}

/* To nearest, even on a tie. */
__device__ inline uint32_t pack_bf16(float low, float high) {
    const __nv_bfloat162 both = __floats2bfloat162_rn(low, high);
    return *reinterpret_cast<const uint32_t *>(&both);
}

__device__ inline float unpack_bf16(uint32_t pair, int high) {
    return __uint_as_float(high ? pair & 0xffff0000u : pair << 16);
}

__device__ inline float half_value(uint16_t half) {
    return __half2float(__ushort_as_half(half));
}

__device__ inline uint16_t half_of(float v) {
    return __half_as_ushort(__float2half_rn(v));
}

/* Copies 16 bytes into shared memory, both addresses multiples of 16; visible after async_wait_but and a
 * barrier. */
__device__ inline void async_copy(void *shared, const void *global) {
    asm volatile(
        "cp.async.cg.shared.global [%0], [%1], 16;" ::"r"((uint32_t)__cvta_generic_to_shared(shared)),
        "l"(global)
        : "memory");
}
/* Closes a group of this thread's copies. */
__device__ inline void async_commit() {
    asm volatile("cp.async.commit_group;" ::: "memory");
}
/* Waits until all but the `newest` groups of this thread's copies are done; a constant. */
__device__ inline void async_wait_but(int newest) {
    if (newest == 0)
        asm volatile("cp.async.wait_group 0;" ::: "memory");
    else if (newest == 1)
        asm volatile("cp.async.wait_group 1;" ::: "memory");
    else
        asm volatile("cp.async.wait_group 2;" ::: "memory");
}

/* `bytes` are requested at the launch. */
#define WIDE_SHARED(name, bytes) extern __shared__ __align__(128) unsigned char name[]

template <typename... P, typename... A>
void launch_wide(void (*kernel)(P...), dim3 grid, dim3 block, size_t shared_bytes, A... args) {
    cudaFuncSetAttribute((const void *)kernel, cudaFuncAttributeMaxDynamicSharedMemorySize,
                         (int)shared_bytes);
    kernel<<<grid, block, shared_bytes, stream()>>>(args...);
}

} // namespace cuda_backend
#endif

namespace cuda_backend {

/* ---- the host's side (frame_runtime.cu) ---- */
/* The first error of the launches since the last call, if any. */
sherf_status finished_work(context *c, const char *what);
int multiprocessors();
/* Host memory that the GPU copies to at full speed; NULL and message: out of memory. */
void *pinned_take(context *c, size_t bytes);
void pinned_give(void *p);

} // namespace cuda_backend
#endif
