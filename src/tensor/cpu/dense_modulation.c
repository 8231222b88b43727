/* demodulation: over the weights [O, I * taps], with the styles' squares repeated for the taps. */
#include <math.h>
#include <string.h>

#include "tensor/cpu/cpu.h"
#include "tensor/cpu/variants.h"

enum { BLOCK = 16 }; /* output channels in a block: sums run block by block, for any thread count */

typedef struct {
    int64_t O, n; /* n = I * taps */
    const float *w, *squares, *d, *dd;
    float *out, *dw, *sums;
} demodulation_job;

static VARIANT_BODY void demodulation_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const demodulation_job *j = arg;
    for (int64_t o = begin; o < end; o++) {
        const float *restrict w = j->w + o * j->n, *restrict s = j->squares;
        float part[16] = {0}, rest = 0; /* sixteen sums, so that the order is the same for every SIMD width */
        int64_t i = 0;
        for (; i + 16 <= j->n; i += 16)
            for (int k = 0; k < 16; k++) part[k] += w[i + k] * w[i + k] * s[i + k];
        for (; i < j->n; i++) rest += w[i] * w[i] * s[i];
        double sum = rest;
        for (int k = 0; k < 16; k++) sum += part[k];
        j->out[o] = (float)(1 / sqrt(sum + 1e-8));
    }
}
VARIANTS(demodulation_rows)

/* g = -dd d^3: dw += g w s^2, sums over the block's o of g w^2 */
static VARIANT_BODY void demodulation_blocks(void *arg, int64_t begin, int64_t end, int thread) {
    const demodulation_job *j = arg;
    for (int64_t block = begin; block < end; block++) {
        float *restrict sum = j->sums ? j->sums + block * j->n : NULL;
        if (sum) memset(sum, 0, (size_t)j->n * sizeof *sum);
        for (int64_t o = block * BLOCK; o < j->O && o < (block + 1) * BLOCK; o++) {
            const float g = -j->dd[o] * j->d[o] * j->d[o] * j->d[o];
            const float *restrict w = j->w + o * j->n, *restrict s = j->squares;
            float *restrict dw = j->dw ? j->dw + o * j->n : NULL;
            for (int64_t i = 0; dw && i < j->n; i++) dw[i] += g * w[i] * s[i];
            for (int64_t i = 0; sum && i < j->n; i++) sum[i] += g * w[i] * w[i];
        }
    }
}
VARIANTS(demodulation_blocks)

static bool demodulation_of(op_call *call, demodulation_job *j) {
    const tensor *w = call->in[0];
    const int64_t I = w->dim[1], T = w->dim[2] * w->dim[3];
    const float *s = call->in[1]->data;
    *j = (demodulation_job){.O = w->dim[0], .n = I * T, .w = w->data};
    float *squares = arena_alloc(call->c, call->scratch, (size_t)j->n, sizeof *squares);
    for (int64_t i = 0; squares && i < j->n; i++) squares[i] = s[i / T] * s[i / T];
    j->squares = squares;
    return squares;
}

sherf_status cpu_demodulation_forward(op_call *call) {
    demodulation_job j;
    if (!demodulation_of(call, &j)) return SHERF_NO_MEMORY;
    j.out = call->out[0]->data;
    parallel_for(call->c, j.O, 1 + (1 << 14) / (j.n + 1), demodulation_rows_best(), &j);
    return SHERF_OK;
}

sherf_status cpu_demodulation_backward(op_call *call) {
    demodulation_job j;
    if (!demodulation_of(call, &j)) return SHERF_NO_MEMORY;
    const int64_t blocks = (j.O + BLOCK - 1) / BLOCK, T = call->in[0]->dim[2] * call->in[0]->dim[3];
    j.d = call->out[0]->data;
    j.dd = call->dout[0]->data;
    j.dw = call->din[0] ? call->din[0]->data : NULL;
    if (call->din[1]) {
        j.sums = arena_alloc(call->c, call->scratch, (size_t)(blocks * j.n), sizeof *j.sums);
        if (!j.sums) return SHERF_NO_MEMORY;
    }
    parallel_for(call->c, blocks, 1, demodulation_blocks_best(), &j);
    const float *s = call->in[1]->data;
    float *ds = call->din[1] ? call->din[1]->data : NULL;
    for (int64_t i = 0; ds && i < j.n; i++) { /* ds[i] = s[i] sum over o and taps of g w^2 */
        double sum = 0;
        for (int64_t b = 0; b < blocks; b++) sum += j.sums[b * j.n + i];
        ds[i / T] += (float)(s[i / T] * sum);
    }
    return SHERF_OK;
}
