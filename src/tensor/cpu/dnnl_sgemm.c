/* oneDNN's sgemm on one thread: linear's own threads share the rows. */
#include <dnnl.h>
#include <omp.h>
#include <stdatomic.h>

#include "tensor/cpu/dnnl_plan.h"
#include "tensor/cpu/sgemm.h"

bool sgemm(bool a_down, bool b_across, int64_t M, int64_t N, int64_t K, float alpha, const float *a,
           int64_t lda, const float *b, int64_t ldb, float beta, float *c, int64_t ldc) {
    static atomic_bool written; /* all its kernels exist, which the first product writes */
    dnnl_mask();
    if (!atomic_load(&written) && !dnnl_room()) return false;
    const int threads = omp_in_parallel() ? 0 : threads_set(1);
    const dnnl_status_t status =
        dnnl_sgemm(a_down ? 'T' : 'N', b_across ? 'T' : 'N', M, N, K, alpha, a, lda, b, ldb, beta, c, ldc);
    if (threads) threads_set(threads);
    if (status == dnnl_success) atomic_store(&written, true);
    return status == dnnl_success;
}
