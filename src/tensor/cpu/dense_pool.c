/* max_pool: channels are contiguous in SIMD, and each maximum's pixel is kept for the gradient. average_pool:
 * sums over rows in fixed blocks (rows.h). */
#include <string.h>

#include "tensor/cpu/rows.h"
#include "tensor/cpu/variants.h"

/* ---- max_pool ---- */
typedef struct {
    pool_attr attr;
    int64_t H, W, C, rows, columns; /* of x; of y */
    const float *x, *dy;
    float *y, *dx;
    int32_t *pixel;
} pool_job;

/* One window: copies the first pixel's values, then takes the others' where they are larger. */
static VARIANT_BODY void pool_window(const pool_job *j, int64_t i, int64_t k) {
    const int64_t C = j->C, at = (i * j->columns + k) * C;
    float *restrict y = j->y + at;
    int32_t *restrict pixel = j->pixel + at;
    bool first = true;
    for (int64_t r = i * j->attr.stride - j->attr.pad, rn = r + j->attr.size; r < rn; r++)
        for (int64_t s = k * j->attr.stride - j->attr.pad, sn = s + j->attr.size; s < sn; s++) {
            if (r < 0 || r >= j->H || s < 0 || s >= j->W) continue;
            const int32_t here = (int32_t)(r * j->W + s);
            const float *restrict x = j->x + here * C;
            if (first)
                for (int64_t c = 0; c < C; c++) {
                    y[c] = x[c];
                    pixel[c] = here;
                }
            else
                for (int64_t c = 0; c < C; c++) {
                    const bool more = x[c] > y[c];
                    y[c] = more ? x[c] : y[c];
                    pixel[c] = more ? here : pixel[c];
                }
            first = false;
        }
}

static VARIANT_BODY void pool_forward(void *arg, int64_t begin, int64_t end, int thread) {
    const pool_job *j = arg;
    for (int64_t i = begin; i < end; i++)
        for (int64_t k = 0; k < j->columns; k++) pool_window(j, i, k);
}
VARIANTS(pool_forward)

/* Windows overlap, so threads share the channels: 16 of them, a cache line, at a time. */
static void pool_backward(void *arg, int64_t begin, int64_t end, int thread) {
    const pool_job *j = arg;
    const int64_t first = begin * 16, last = end * 16 < j->C ? end * 16 : j->C;
    for (int64_t p = 0; p < j->rows * j->columns; p++) {
        const float *dy = j->dy + p * j->C;
        const int32_t *pixel = j->pixel + p * j->C;
        for (int64_t c = first; c < last; c++) j->dx[pixel[c] * j->C + c] += dy[c];
    }
}

static pool_job pool_of(op_call *call) {
    const tensor *x = call->in[0], *y = call->out[0];
    return (pool_job){.attr = *(const pool_attr *)call->attr,
                      .H = x->dim[0],
                      .W = x->dim[1],
                      .C = x->dim[2],
                      .rows = y->dim[0],
                      .columns = y->dim[1],
                      .x = x->data,
                      .y = y->data,
                      .pixel = call->saved};
}

sherf_status cpu_max_pool_forward(op_call *call) {
    pool_job j = pool_of(call);
    parallel_for(call->c, j.rows, 1, pool_forward_best(), &j);
    return SHERF_OK;
}

sherf_status cpu_max_pool_backward(op_call *call) {
    pool_job j = pool_of(call);
    j.dy = call->dout[0]->data;
    j.dx = call->din[0]->data;
    parallel_for(call->c, (j.C + 15) / 16, 1, pool_backward, &j);
    return SHERF_OK;
}

/* ---- average_pool ---- */
typedef struct {
    row_view view;
    const float *dy;
    float *dx;
} average_job;

static VARIANT_BODY void average_back(void *arg, int64_t begin, int64_t end, int thread) {
    const average_job *j = arg;
    for (int64_t r = begin; r < end; r++) {
        float *restrict dx = j->dx + r * j->view.width;
        const float *restrict dy = j->dy;
        const int64_t n = row_width(&j->view, r);
        for (int64_t i = 0; i < n; i++) dx[i] += dy[i];
    }
}
VARIANTS(average_back)

sherf_status cpu_average_pool_forward(op_call *call) {
    const tensor *x = call->in[0];
    memset(call->out[0]->data, 0, (size_t)tensor_columns(x) * sizeof(float));
    return column_sums_add(call, x, 1 / (float)tensor_rows(x), call->out[0]->data);
}

sherf_status cpu_average_pool_backward(op_call *call) {
    average_job j = {.view = rows_of(call->in[0]), .dx = call->din[0]->data};
    float *dy = row_pattern(call, &j.view, call->dout[0]->data);
    if (!dy) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < j.view.width; i++) dy[i] /= (float)tensor_rows(call->in[0]);
    j.dy = dy;
    parallel_for(call->c, j.view.rows, row_grain(&j.view), average_back_best(), &j);
    return SHERF_OK;
}
