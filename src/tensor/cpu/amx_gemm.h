/* Matrix products on AMX tiles: float32 in and out, products in bf16, float32 sums. Needs ISA_AMX. */
#ifndef SHERF_AMX_GEMM_H
#define SHERF_AMX_GEMM_H

#include "tensor/cpu/cpu.h"

/* C[m,n] = gain sum_k A[m,k] B[k,n] + bias[n], or, with `add`, added to C (bias NULL: none).
 * A[m,k] = a[m * lda + k], or a[k * lda + m] with a_down; B[k,n] = b[k * ldb + n], or b[n * ldb + k] with
 * b_across. */
typedef struct {
    int64_t M, N, K;
    const float *a, *b, *bias;
    float *c;
    int64_t lda, ldb, ldc;
    bool a_down, b_across, add;
    float gain;
} amx_product;

/* Many rows M, few N and K (activations times weights): threads share the rows; B is packed once. A must not
 * be a_down. */
sherf_status amx_gemm_rows(op_call *call, const amx_product *p);
/* Few M and N, many K (gradients of weights): adds to C. Sums over K go in blocks fixed by the shape and are
 * joined in order, so the result does not depend on the thread count. A must be a_down, B not b_across. */
sherf_status amx_gemm_deep(op_call *call, const amx_product *p);
#endif
