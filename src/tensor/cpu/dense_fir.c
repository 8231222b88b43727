/* fir_upsample: separable; first rows into a line buffer, then columns. The gradient is the same gathering in
 * reverse. */
#include "tensor/cpu/cpu.h"
#include "tensor/cpu/variants.h"

/* The sources of one row (or column) of the result: at most four, with their weights. */
typedef struct {
    int count;
    int64_t at[4];
    float weight[4];
} taps;

typedef struct {
    fir_attr attr;
    bool backward;
    int64_t rows, columns, from_rows, from_columns, C; /* of the result; of the source */
    const float *from;
    float *to;
    float *lines; /* from_columns * C a thread */
} fir_job;

static const float kernel_taps[4] = {1 / 8.0f, 3 / 8.0f, 3 / 8.0f, 1 / 8.0f};

/* Forward: y[i] reads z[i + r - before] = x[(i + r - before) / up] where the division is exact. Backward: y[i
 * up + before - r] read x[i]. */
static VARIANT_BODY taps taps_of(const fir_job *j, int64_t i, int64_t limit, float gain) {
    taps t = {0};
    for (int r = 0; r < 4; r++) {
        int64_t at = j->backward ? i * j->attr.up + j->attr.before - r : i + r - j->attr.before;
        if (at < 0) continue;
        if (!j->backward) {
            if (at % j->attr.up) continue;
            at /= j->attr.up;
        }
        if (at >= limit) continue;
        t.at[t.count] = at;
        t.weight[t.count++] = kernel_taps[r] * gain;
    }
    for (int k = t.count; k < 4; k++) t.at[k] = 0; /* weight 0: may read any valid place */
    return t;
}

/* to[i] (+)= the weighted sum of count runs of n values. */
static VARIANT_BODY void gather(const taps *t, const float *from, int64_t step, int64_t n, bool add,
                                float *restrict to) {
    const float *restrict a = from + t->at[0] * step, *restrict b = from + t->at[1] * step;
    const float *restrict c = from + t->at[2] * step, *restrict d = from + t->at[3] * step;
    const float wa = t->weight[0], wb = t->weight[1], wc = t->weight[2], wd = t->weight[3];
    if (t->count <= 2 && add)
        for (int64_t i = 0; i < n; i++) to[i] += wa * a[i] + wb * b[i];
    else if (t->count <= 2)
        for (int64_t i = 0; i < n; i++) to[i] = wa * a[i] + wb * b[i];
    else if (add)
        for (int64_t i = 0; i < n; i++) to[i] += wa * a[i] + wb * b[i] + (wc * c[i] + wd * d[i]);
    else
        for (int64_t i = 0; i < n; i++) to[i] = wa * a[i] + wb * b[i] + (wc * c[i] + wd * d[i]);
}

static VARIANT_BODY void fir_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const fir_job *j = arg;
    const int64_t line = j->from_columns * j->C;
    float *buffer = j->lines + thread * line;
    for (int64_t i = begin; i < end; i++) {
        const taps down = taps_of(j, i, j->from_rows, j->attr.gain);
        gather(&down, j->from, line, line, false, buffer);
        for (int64_t k = 0; k < j->columns; k++) {
            const taps across = taps_of(j, k, j->from_columns, 1);
            gather(&across, buffer, j->C, j->C, j->backward, j->to + (i * j->columns + k) * j->C);
        }
    }
}
VARIANTS(fir_rows)

static sherf_status fir_run(op_call *call, fir_job *j) {
    j->lines = arena_alloc(call->c, call->scratch,
                           (size_t)call->c->threads * (size_t)(j->from_columns * j->C), sizeof(float));
    if (!j->lines) return SHERF_NO_MEMORY;
    parallel_for(call->c, j->rows, 4, fir_rows_best(), j);
    return SHERF_OK;
}

sherf_status cpu_fir_upsample_forward(op_call *call) {
    const tensor *x = call->in[0], *y = call->out[0];
    fir_job j = {*(const fir_attr *)call->attr,
                 false,
                 y->dim[0],
                 y->dim[1],
                 x->dim[0],
                 x->dim[1],
                 x->dim[2],
                 x->data,
                 y->data};
    return fir_run(call, &j);
}

sherf_status cpu_fir_upsample_backward(op_call *call) {
    const tensor *x = call->in[0], *y = call->out[0];
    fir_job j = {*(const fir_attr *)call->attr,
                 true,
                 x->dim[0],
                 x->dim[1],
                 y->dim[0],
                 y->dim[1],
                 x->dim[2],
                 call->dout[0]->data,
                 call->din[0]->data};
    return fir_run(call, &j);
}
