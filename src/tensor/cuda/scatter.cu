/* A stable radix sort, 4 bits in each pass. Every thread has a run of entries: it counts their digits, the
 * counts are summed over all threads digit by digit, and the thread moves its run. */
#include "tensor/cuda/scatter.h"

namespace cuda_backend {

enum { DIGIT_BITS = 4, DIGITS = 1 << DIGIT_BITS, RUN = 64, SCAN_THREADS = 256 };

/* table[i] = sum of table[0 .. i - 1], by one block: each thread has a contiguous part. */
__global__ static void scan_kernel(int64_t n, int32_t *table) {
    __shared__ int32_t before[SCAN_THREADS];
    const int64_t begin = n * threadIdx.x / SCAN_THREADS, end = n * (threadIdx.x + 1) / SCAN_THREADS;
    int32_t sum = 0;
    for (int64_t i = begin; i < end; i++) sum += table[i];
    before[threadIdx.x] = sum;
    __syncthreads();
    if (threadIdx.x == 0) {
        int32_t all = 0;
        for (int t = 0; t < SCAN_THREADS; t++) {
            const int32_t one = before[t];
            before[t] = all;
            all += one;
        }
    }
    __syncthreads();
    sum = before[threadIdx.x];
    for (int64_t i = begin; i < end; i++) {
        const int32_t one = table[i];
        table[i] = sum;
        sum += one;
    }
}

bool sort_keys(op_call *call, int64_t count, int64_t places, int32_t *key, sorted *out) {
    const int64_t runs = divided_up(count, RUN);
    int32_t *other_key = scratch<int32_t>(call, count), *entry = scratch<int32_t>(call, count);
    int32_t *other_entry = scratch<int32_t>(call, count), *table = scratch<int32_t>(call, runs * DIGITS);
    if (!other_key || !entry || !other_entry || !table) return false;
    each(count, [=] __device__(int64_t i) { entry[i] = (int32_t)i; });
    for (int shift = 0; shift < 32 && places >> shift > 0; shift += DIGIT_BITS) {
        each(runs, [=] __device__(int64_t r) {
            int32_t n[DIGITS] = {};
            for (int64_t i = r * RUN; i < (r + 1) * RUN && i < count; i++)
                n[key[i] >> shift & (DIGITS - 1)]++;
            for (int d = 0; d < DIGITS; d++) table[d * runs + r] = n[d];
        });
        if (count > 0) launch(scan_kernel, dim3(1), dim3(SCAN_THREADS), runs * DIGITS, table);
        each(runs, [=] __device__(int64_t r) {
            int32_t at[DIGITS];
            for (int d = 0; d < DIGITS; d++) at[d] = table[d * runs + r];
            for (int64_t i = r * RUN; i < (r + 1) * RUN && i < count; i++) {
                const int32_t to = at[key[i] >> shift & (DIGITS - 1)]++;
                other_key[to] = key[i];
                other_entry[to] = entry[i];
            }
        });
        int32_t *swap = key;
        key = other_key;
        other_key = swap;
        swap = entry;
        entry = other_entry;
        other_entry = swap;
    }
    *out = {count, key, entry};
    return true;
}

} // namespace cuda_backend
