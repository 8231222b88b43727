/* oneDNN's float32 matrix product on the calling thread. */
#ifndef SHERF_SGEMM_H
#define SHERF_SGEMM_H

#include <stdbool.h>
#include <stdint.h>

/* C[M,N] = alpha op(A) op(B) + beta C, row-major; a_down: A is stored [K, M]; b_across: B is stored [N, K].
 * False: not enough memory. */
bool sgemm(bool a_down, bool b_across, int64_t M, int64_t N, int64_t K, float alpha, const float *a,
           int64_t lda, const float *b, int64_t ldb, float beta, float *c, int64_t ldc);
#endif
