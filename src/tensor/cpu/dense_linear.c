/* linear: AMX tiles in bf16, oneDNN's sgemm over fixed runs of rows in float32, and plain SIMD loops for few
 * rows or few outputs. */
#include <string.h>

#include "tensor/cpu/amx_gemm.h"
#include "tensor/cpu/linear.h"
#include "tensor/cpu/rows.h"
#include "tensor/cpu/sgemm.h"
#include "tensor/cpu/variants.h"

typedef struct {
    int64_t R, I, O;
    const float *x, *w, *b, *dy;
    float *y, *dx, *dw;
    float gain, bias_gain;
    float *sums; /* gradients of w, one for each block of rows; a single one is dw itself */
    int64_t block_rows, blocks;
    bool fresh; /* dx is written instead of added to */
    atomic_bool failed;
} linear_job;

enum { FEW = 16 };

static bool is_small(const linear_job *j) {
    return j->R < FEW || j->O < FEW;
}
static bool is_amx(const op_call *call, const linear_job *j) {
    return call->bf16 && isa_has_bf16() && j->I >= FEW;
}

/* Blocks depend only on the shape: at most 16, of at least 64 rows. */
static void blocks_of(linear_job *j) {
    j->block_rows = (j->R + 15) / 16 < 64 ? 64 : (j->R + 15) / 16;
    j->blocks = (j->R + j->block_rows - 1) / j->block_rows;
}

static void linear_of(op_call *call, linear_job *j) {
    const tensor *x = call->in[0], *w = call->in[1], *b = call->in[2];
    const linear_attr *a = call->attr;
    *j = (linear_job){.I = w->dim[1], .O = w->dim[0], .x = x->data, .w = w->data, .b = b ? b->data : NULL};
    j->R = tensor_count(x) / j->I;
    j->gain = a->gain;
    j->bias_gain = a->bias_gain;
    blocks_of(j);
}

static int64_t block_end(const linear_job *j, int64_t block) {
    return (block + 1) * j->block_rows < j->R ? (block + 1) * j->block_rows : j->R;
}

/* ---- few rows or few outputs ---- */
static VARIANT_BODY void small_forward(void *arg, int64_t begin, int64_t end, int thread) {
    const linear_job *j = arg;
    for (int64_t at = begin; at < end; at++) {
        const int64_t r = at / j->O, o = at % j->O;
        const float *restrict x = j->x + r * j->I, *restrict w = j->w + o * j->I;
        float part[32] = {0}, sum = 0;
        int64_t i = 0;
        for (; i + 32 <= j->I; i += 32)
            for (int k = 0; k < 32; k++) part[k] += x[i + k] * w[i + k];
        for (; i < j->I; i++) sum += x[i] * w[i];
        for (int half = 16; half; half /= 2)
            for (int k = 0; k < half; k++) part[k] += part[k + half];
        j->y[at] = (sum + part[0]) * j->gain + (j->b ? j->b[o] * j->bias_gain : 0);
    }
}
VARIANTS(small_forward)

static VARIANT_BODY void small_data(void *arg, int64_t begin, int64_t end, int thread) {
    const linear_job *j = arg;
    for (int64_t r = begin; r < end; r++) {
        float *restrict dx = j->dx + r * j->I;
        if (j->fresh) memset(dx, 0, (size_t)j->I * sizeof *dx);
        for (int64_t o = 0; o < j->O; o++) {
            const float g = j->dy[r * j->O + o] * j->gain, *restrict w = j->w + o * j->I;
            for (int64_t i = 0; i < j->I; i++) dx[i] += g * w[i];
        }
    }
}
VARIANTS(small_data)

static VARIANT_BODY void small_weights(void *arg, int64_t begin, int64_t end, int thread) {
    const linear_job *j = arg;
    for (int64_t block = begin; block < end; block++) {
        float *sums = j->sums + block * j->O * j->I;
        for (int64_t r = block * j->block_rows; r < block_end(j, block); r++)
            for (int64_t o = 0; o < j->O; o++) {
                const float g = j->dy[r * j->O + o] * j->gain, *restrict x = j->x + r * j->I;
                float *restrict to = sums + o * j->I;
                for (int64_t i = 0; i < j->I; i++) to[i] += g * x[i];
            }
    }
}
VARIANTS(small_weights)

/* ---- sgemm over runs of rows ---- */
static void large_forward(void *arg, int64_t begin, int64_t end, int thread) {
    linear_job *j = arg;
    for (int64_t block = begin; block < end; block++) {
        const int64_t first = block * j->block_rows, rows = block_end(j, block) - first;
        float *y = j->y + first * j->O;
        if (!sgemm(false, true, rows, j->O, j->I, j->gain, j->x + first * j->I, j->I, j->w, j->I, 0, y, j->O))
            j->failed = true;
        for (int64_t r = 0; j->b && r < rows; r++, y += j->O)
            for (int64_t o = 0; o < j->O; o++) y[o] += j->b[o] * j->bias_gain;
    }
}

static void large_data(void *arg, int64_t begin, int64_t end, int thread) {
    linear_job *j = arg;
    for (int64_t block = begin; block < end; block++) {
        const int64_t first = block * j->block_rows, rows = block_end(j, block) - first;
        if (!sgemm(false, false, rows, j->I, j->O, j->gain, j->dy + first * j->O, j->O, j->w, j->I, !j->fresh,
                   j->dx + first * j->I, j->I))
            j->failed = true;
    }
}

static void large_weights(void *arg, int64_t begin, int64_t end, int thread) {
    linear_job *j = arg;
    for (int64_t block = begin; block < end; block++) {
        const int64_t first = block * j->block_rows, rows = block_end(j, block) - first;
        if (!sgemm(true, false, j->O, j->I, rows, j->gain, j->dy + first * j->O, j->O, j->x + first * j->I,
                   j->I, 1, j->sums + block * j->O * j->I, j->I))
            j->failed = true;
    }
}

static sherf_status finished(op_call *call, linear_job *j) {
    return j->failed ? failure(call->c, SHERF_NO_MEMORY, "out of memory: a matrix product of oneDNN")
                     : SHERF_OK;
}

sherf_status cpu_linear_forward(op_call *call) {
    linear_job j;
    linear_of(call, &j);
    j.y = call->out[0]->data;
    if (is_small(&j)) {
        parallel_for(call->c, j.R * j.O, 1 + (1 << 16) / j.I, small_forward_best(), &j);
        return SHERF_OK;
    }
    if (!is_amx(call, &j)) {
        parallel_for(call->c, j.blocks, 1, large_forward, &j);
        return finished(call, &j);
    }
    float *bias = j.b ? arena_alloc(call->c, call->scratch, (size_t)j.O, sizeof *bias) : NULL;
    if (j.b && !bias) return SHERF_NO_MEMORY;
    for (int64_t o = 0; bias && o < j.O; o++) bias[o] = j.b[o] * j.bias_gain;
    amx_product p = {.M = j.R, .N = j.O, .K = j.I, .a = j.x, .lda = j.I, .b = j.w, .ldb = j.I};
    p.b_across = true;
    p.bias = bias;
    p.c = j.y;
    p.ldc = j.O;
    p.gain = j.gain;
    return amx_gemm_rows(call, &p);
}

static sherf_status backward_data(op_call *call, linear_job *j) {
    j->dx = call->din[0]->data;
    j->fresh = call->fresh[0];
    if (is_small(j)) {
        parallel_for(call->c, j->R, 1 + (1 << 16) / (j->I * j->O), small_data_best(), j);
        return SHERF_OK;
    }
    if (!is_amx(call, j)) {
        parallel_for(call->c, j->blocks, 1, large_data, j);
        return finished(call, j);
    }
    amx_product p = {.M = j->R, .N = j->I, .K = j->O, .a = j->dy, .lda = j->O, .b = j->w, .ldb = j->I};
    p.c = j->dx;
    p.ldc = j->I;
    p.gain = j->gain;
    p.add = !j->fresh;
    return amx_gemm_rows(call, &p);
}

typedef struct {
    const float *sums;
    float *to;
    int64_t n, blocks;
} join_job;

static VARIANT_BODY void join(void *arg, int64_t begin, int64_t end, int thread) {
    const join_job *j = arg;
    for (int64_t b = 0; b < j->blocks; b++)
        for (int64_t i = begin; i < end; i++) j->to[i] += j->sums[b * j->n + i];
}
VARIANTS(join)

static sherf_status weights_float(op_call *call, linear_job *j, float *dw) {
    const int64_t n = j->O * j->I;
    j->sums = dw;
    if (j->blocks > 1) {
        j->sums = arena_alloc(call->c, call->scratch, (size_t)(j->blocks * n), sizeof *j->sums);
        if (!j->sums) return SHERF_NO_MEMORY;
        memset(j->sums, 0, (size_t)(j->blocks * n) * sizeof *j->sums);
    }
    parallel_for(call->c, j->blocks, 1, is_small(j) ? small_weights_best() : large_weights, j);
    if (j->blocks > 1) parallel_for(call->c, n, 1 << 13, join_best(), &(join_job){j->sums, dw, n, j->blocks});
    return finished(call, j);
}

static sherf_status backward_weights(op_call *call, linear_job *j) {
    float *dw = call->din[1]->data;
    if (!is_small(j) && is_amx(call, j)) {
        amx_product p = {.M = j->O, .N = j->I, .K = j->R, .a = j->dy, .lda = j->O, .b = j->x, .ldb = j->I};
        p.a_down = true;
        p.c = dw;
        p.ldc = j->I;
        p.gain = j->gain;
        p.add = true;
        return amx_gemm_deep(call, &p);
    }
    return weights_float(call, j, dw);
}

sherf_status linear_weights_add(op_call *call, const linear_sizes *n, const float *x, const float *dy,
                                float *dw) {
    linear_job j = {.R = n->R, .I = n->I, .O = n->O, .x = x, .dy = dy, .gain = n->gain};
    blocks_of(&j);
    return weights_float(call, &j, dw);
}

sherf_status cpu_linear_backward(op_call *call) {
    linear_job j;
    linear_of(call, &j);
    j.dy = call->dout[0]->data;
    sherf_status status = SHERF_OK;
    const arena_mark mark = arena_position(call->scratch);
    if (call->din[0]) status = backward_data(call, &j);
    arena_rewind(call->scratch, mark);
    if (status == SHERF_OK && call->din[1]) status = backward_weights(call, &j);
    arena_rewind(call->scratch, mark);
    if (status == SHERF_OK && call->din[2])
        status = column_sums_add(call, call->dout[0], j.bias_gain, call->din[2]->data);
    return status;
}
