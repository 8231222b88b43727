/* Matrix products by cuBLAS, which is opened on first use: a program that never computes on a GPU does not
 * need the library. One handle for the process, on its one stream; there cuBLAS gives the same bits for the
 * same call. */
#include <cublas_v2.h>
#include <cuda_bf16.h>
#include <dlfcn.h>

#include "tensor/cuda/product.h"

namespace cuda_backend {

/* cublasGemmEx of the C interface; the header has others of that name for C++. */
typedef cublasStatus_t (*gemm_function)(cublasHandle_t, cublasOperation_t, cublasOperation_t, int, int, int,
                                        const void *, const void *, cudaDataType, int, const void *,
                                        cudaDataType, int, const void *, void *, cudaDataType, int,
                                        cublasComputeType_t, cublasGemmAlgo_t);

struct cublas {
    decltype(&cublasCreate_v2) create;
    decltype(&cublasSetStream_v2) set_stream;
    gemm_function gemm;
    cublasHandle_t handle;
    bool good;
};

#define TEXT_(x) #x
#define TEXT(x) TEXT_(x)

static cublas cublas_open() {
    cublas b = {};
    /* The version of the headers; its structs are those used in this file. */
#define CUBLAS_FILE "libcublas.so." TEXT(CUBLAS_VER_MAJOR)
    void *library = dlopen(CUBLAS_FILE, RTLD_NOW | RTLD_LOCAL);
    if (!library) library = dlopen("/usr/local/cuda/lib64/" CUBLAS_FILE, RTLD_NOW | RTLD_LOCAL);
    if (!library) return b;
    b.create = (decltype(b.create))dlsym(library, "cublasCreate_v2");
    b.set_stream = (decltype(b.set_stream))dlsym(library, "cublasSetStream_v2");
    b.gemm = (gemm_function)dlsym(library, "cublasGemmEx");
    b.good = b.create && b.set_stream && b.gemm && b.create(&b.handle) == CUBLAS_STATUS_SUCCESS &&
             b.set_stream(b.handle, stream()) == CUBLAS_STATUS_SUCCESS;
    return b;
}

static const __nv_bfloat16 *rounded(op_call *call, const float *from, int64_t count) {
    __nv_bfloat16 *to = scratch<__nv_bfloat16>(call, count);
    if (to) each(count, [=] __device__(int64_t i) { to[i] = __float2bfloat16(from[i]); });
    return to;
}

/* Floats from the first to the last of a stored matrix. */
static int64_t span(int64_t rows, int64_t columns, int64_t distance) {
    return rows ? (rows - 1) * distance + columns : 0;
}

sherf_status product(op_call *call, const product_shape &s, const float *a, const float *b, float *y) {
    static const cublas library = cublas_open();
    if (!library.good)
        return failure(call->c, SHERF_UNSUPPORTED, "%s: cuBLAS (%s) cannot be opened", op_name(call->op),
                       CUBLAS_FILE);
    if (s.M == 0 || s.N == 0 || (s.K == 0 && s.beta == 1)) return SHERF_OK;
    if (s.M > INT32_MAX || s.N > INT32_MAX || s.K > INT32_MAX || s.lda > INT32_MAX || s.ldb > INT32_MAX ||
        s.ldy > INT32_MAX)
        return failure(call->c, SHERF_UNSUPPORTED, "%s: a product larger than cuBLAS takes",
                       op_name(call->op));
    const void *from_a = a, *from_b = b;
    const arena_mark mark = arena_position(call->scratch);
    if (call->bf16) {
        from_a = rounded(call, a, s.a_turned ? span(s.K, s.M, s.lda) : span(s.M, s.K, s.lda));
        from_b = rounded(call, b, s.b_turned ? span(s.N, s.K, s.ldb) : span(s.K, s.N, s.ldb));
        if (!from_a || !from_b) return SHERF_NO_MEMORY;
    }
    /* cuBLAS is column-major, so it sees every matrix transposed: y^T = B^T A^T. */
    const cudaDataType type = call->bf16 ? CUDA_R_16BF : CUDA_R_32F;
    const cublasStatus_t code = library.gemm(
        library.handle, s.b_turned ? CUBLAS_OP_T : CUBLAS_OP_N, s.a_turned ? CUBLAS_OP_T : CUBLAS_OP_N,
        (int)s.N, (int)s.M, (int)s.K, &s.alpha, from_b, type, (int)s.ldb, from_a, type, (int)s.lda, &s.beta,
        y, CUDA_R_32F, (int)s.ldy, CUBLAS_COMPUTE_32F, CUBLAS_GEMM_DEFAULT);
    /* The stream is in order: work that takes this scratch next runs after the product. */
    arena_rewind(call->scratch, mark);
    if (code == CUBLAS_STATUS_SUCCESS) return SHERF_OK;
    return failure(call->c, SHERF_UNSUPPORTED, "%s: cuBLAS fails with its code %d", op_name(call->op),
                   (int)code);
}

} // namespace cuda_backend
