/* Matrix products of the CUDA backend: cuBLAS (product.cu). */
#ifndef SHERF_CUDA_PRODUCT_H
#define SHERF_CUDA_PRODUCT_H

#include "tensor/cuda/cuda.h"

namespace cuda_backend {

/* y[M,N] = alpha A B + beta y, with A [M,K] and B [K,N], row-major. lda, ldb and ldy are the distances
 * between stored rows. A transposed matrix is stored as [K,M] or [N,K]. With beta 0, y is written without
 * being read. */
struct product_shape {
    int64_t M, N, K;
    bool a_turned, b_turned;
    int64_t lda, ldb, ldy;
    float alpha, beta;
};

/* In float32; if the call says so, A and B are rounded to bf16 and sums stay float32. */
sherf_status product(op_call *call, const product_shape &shape, const float *a, const float *b, float *y);

} // namespace cuda_backend
#endif
