/* Sums rows into numbered places, with the same bits every time: entries are sorted by place in a stable
 * order, and every place sums its own. */
#ifndef SHERF_CUDA_SCATTER_H
#define SHERF_CUDA_SCATTER_H

#include "tensor/cuda/cuda.h"

namespace cuda_backend {

/* Entries by place: keys ascending, and in entry[] their original indices; equal keys keep their order. */
struct sorted {
    int64_t count;
    const int32_t *key, *entry;
};

/* Sorts keys in [0, places]; the key `places` is for entries without a place. Changes the keys. False: out of
 * memory. */
bool sort_keys(op_call *call, int64_t count, int64_t places, int32_t *key, sorted *out);

/* The first entry of at least this key, for kernels. */
__device__ inline int64_t first_of(const sorted &s, int64_t key) {
    int64_t low = 0, high = s.count;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (s.key[middle] < key)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

} // namespace cuda_backend
#endif
