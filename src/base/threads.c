/* parallel_for on OpenMP. Inside a parallel region it stays on the calling thread. */
#include <omp.h>

#include "base/base.h"

int threads_available(void) {
    int n = omp_get_num_procs();
    return n > 0 ? n : 1;
}

void parallel_for(const context *c, int64_t n, int64_t grain, range_function f, void *arg) {
    if (n <= 0) return;
    if (grain < 1) grain = 1;
    int64_t parts = (n + grain - 1) / grain;
    if (parts > c->threads) parts = c->threads;
    if (parts <= 1 || omp_in_parallel()) {
        f(arg, 0, n, 0);
        return;
    }
#pragma omp parallel for schedule(static, 1) num_threads((int)parts)
    for (int64_t i = 0; i < parts; i++) f(arg, n * i / parts, n * (i + 1) / parts, (int)i);
}
