/* bias_act, scale_channels, add, scale, mask_rows: single passes over memory. */
#include <string.h>

#include "tensor/cpu/rows.h"
#include "tensor/cpu/variants.h"

/* ---- bias_act ---- */
typedef struct {
    row_view view;
    bias_act_attr attr;
    const float *x, *b, *dy;
    float *y, *dx, *sums;
    bool fresh; /* dx: cleared row by row, in the L1 cache */
} act_job;

static VARIANT_BODY void act_forward(void *arg, int64_t begin, int64_t end, int thread) {
    const act_job *j = arg;
    const float high = j->attr.clamp > 0 ? j->attr.clamp : __builtin_inff();
    const float slope = j->attr.slope, gain = j->attr.gain;
    for (int64_t r = begin; r < end; r++) {
        const int64_t n = row_width(&j->view, r);
        const float *restrict x = j->x + r * j->view.width, *restrict b = j->b;
        float *restrict y = j->y + r * j->view.width;
        for (int64_t i = 0; i < n; i++) {
            float v = x[i] + b[i];
            v = (v >= 0 ? v : slope * v) * gain;
            v = v > high ? high : v;
            y[i] = v < -high ? -high : v;
        }
    }
}
VARIANTS(act_forward)

/* gain act'(v), 0 where the clamp holds */
static VARIANT_BODY float act_slope(float v, float slope, float gain, float high) {
    const float s = v >= 0 ? gain : slope * gain, y = (v >= 0 ? v : slope * v) * gain;
    return y >= high || y <= -high ? 0 : s;
}

static VARIANT_BODY void act_backward(void *arg, int64_t begin, int64_t end, int thread) {
    const act_job *j = arg;
    const row_view *v = &j->view;
    const float high = j->attr.clamp > 0 ? j->attr.clamp : __builtin_inff();
    const float slope = j->attr.slope, gain = j->attr.gain;
    for (int64_t block = begin; block < end; block++) {
        float *restrict sum = j->sums ? j->sums + block * v->width : NULL;
        if (sum) memset(sum, 0, (size_t)v->width * sizeof *sum);
        for (int64_t r = block * v->block_rows; r < v->rows && r < (block + 1) * v->block_rows; r++) {
            const int64_t n = row_width(v, r);
            const float *restrict x = j->x + r * v->width, *restrict b = j->b;
            const float *restrict dy = j->dy + r * v->width;
            float *restrict dx = j->dx ? j->dx + r * v->width : NULL;
            if (dx && j->fresh) memset(dx, 0, (size_t)n * sizeof *dx);
            if (dx && sum)
                for (int64_t i = 0; i < n; i++) {
                    const float g = dy[i] * act_slope(x[i] + b[i], slope, gain, high);
                    dx[i] += g;
                    sum[i] += g;
                }
            else if (dx)
                for (int64_t i = 0; i < n; i++) dx[i] += dy[i] * act_slope(x[i] + b[i], slope, gain, high);
            else if (sum)
                for (int64_t i = 0; i < n; i++) sum[i] += dy[i] * act_slope(x[i] + b[i], slope, gain, high);
        }
    }
}
VARIANTS(act_backward)

static const float *channel_values(const tensor *t) {
    return t ? tensor_f32(t) : NULL;
}

sherf_status cpu_bias_act_forward(op_call *call) {
    act_job j = {.view = rows_of(call->in[0]), .attr = *(const bias_act_attr *)call->attr};
    j.x = call->in[0]->data;
    j.y = call->out[0]->data;
    j.b = row_pattern(call, &j.view, channel_values(call->in[1]));
    if (!j.b) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.rows, row_grain(&j.view), act_forward_best(), &j);
    return SHERF_OK;
}

sherf_status cpu_bias_act_backward(op_call *call) {
    act_job j = {.view = rows_of(call->in[0]), .attr = *(const bias_act_attr *)call->attr};
    j.x = call->in[0]->data;
    j.dy = call->dout[0]->data;
    j.dx = call->din[0] ? call->din[0]->data : NULL;
    j.fresh = call->fresh[0];
    j.b = row_pattern(call, &j.view, channel_values(call->in[1]));
    j.sums = call->din[1] ? block_sums(call, &j.view, 1) : NULL;
    if (!j.b || (call->din[1] && !j.sums)) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.blocks, 1, act_backward_best(), &j);
    if (j.sums) block_sums_add(&j.view, j.sums, 1, 0, 1, call->din[1]->data);
    return SHERF_OK;
}

/* ---- scale_channels ---- */
typedef struct {
    row_view view;
    const float *x, *s, *dy;
    float *y, *dx, *sums;
    bool fresh;
} channels_job;

static VARIANT_BODY void channels_forward(void *arg, int64_t begin, int64_t end, int thread) {
    const channels_job *j = arg;
    for (int64_t r = begin; r < end; r++) {
        const int64_t n = row_width(&j->view, r);
        const float *restrict x = j->x + r * j->view.width, *restrict s = j->s;
        float *restrict y = j->y + r * j->view.width;
        for (int64_t i = 0; i < n; i++) y[i] = x[i] * s[i];
    }
}
VARIANTS(channels_forward)

static VARIANT_BODY void channels_backward(void *arg, int64_t begin, int64_t end, int thread) {
    const channels_job *j = arg;
    const row_view *v = &j->view;
    for (int64_t block = begin; block < end; block++) {
        float *restrict sum = j->sums ? j->sums + block * v->width : NULL;
        if (sum) memset(sum, 0, (size_t)v->width * sizeof *sum);
        for (int64_t r = block * v->block_rows; r < v->rows && r < (block + 1) * v->block_rows; r++) {
            const int64_t n = row_width(v, r);
            const float *restrict x = j->x + r * v->width, *restrict s = j->s;
            const float *restrict dy = j->dy + r * v->width;
            float *restrict dx = j->dx ? j->dx + r * v->width : NULL;
            if (dx && j->fresh) memset(dx, 0, (size_t)n * sizeof *dx);
            if (dx)
#pragma omp simd
                for (int64_t i = 0; i < n; i++) dx[i] += dy[i] * s[i];
            if (sum)
#pragma omp simd
                for (int64_t i = 0; i < n; i++) sum[i] += dy[i] * x[i];
        }
    }
}
VARIANTS(channels_backward)

sherf_status cpu_scale_channels_forward(op_call *call) {
    channels_job j = {.view = rows_of(call->in[0]), .x = call->in[0]->data, .y = call->out[0]->data};
    j.s = row_pattern(call, &j.view, call->in[1]->data);
    if (!j.s) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.rows, row_grain(&j.view), channels_forward_best(), &j);
    return SHERF_OK;
}

sherf_status cpu_scale_channels_backward(op_call *call) {
    channels_job j = {.view = rows_of(call->in[0]), .x = call->in[0]->data, .dy = call->dout[0]->data};
    j.dx = call->din[0] ? call->din[0]->data : NULL;
    j.fresh = call->fresh[0];
    j.s = row_pattern(call, &j.view, call->in[1]->data);
    j.sums = call->din[1] ? block_sums(call, &j.view, 1) : NULL;
    if (!j.s || (call->din[1] && !j.sums)) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.blocks, 1, channels_backward_best(), &j);
    if (j.sums) block_sums_add(&j.view, j.sums, 1, 0, 1, call->din[1]->data);
    return SHERF_OK;
}

/* ---- add, scale ---- */
typedef struct {
    const float *a, *b;
    float *y, factor;
} flat_job;
enum { FLAT_GRAIN = 1 << 14 };

static VARIANT_BODY void sum_range(void *arg, int64_t begin, int64_t end, int thread) {
    const flat_job *j = arg;
    for (int64_t i = begin; i < end; i++) j->y[i] = j->a[i] + j->b[i];
}
VARIANTS(sum_range)

static VARIANT_BODY void scaled_range(void *arg, int64_t begin, int64_t end, int thread) {
    const flat_job *j = arg;
    for (int64_t i = begin; i < end; i++) j->y[i] = j->factor * j->a[i];
}
VARIANTS(scaled_range)

static VARIANT_BODY void scaled_add_range(void *arg, int64_t begin, int64_t end, int thread) {
    const flat_job *j = arg;
    for (int64_t i = begin; i < end; i++) j->y[i] += j->factor * j->a[i];
}
VARIANTS(scaled_add_range)

void cpu_add_scaled(const context *c, int64_t n, float factor, const float *from, bool fresh, float *to) {
    parallel_for(c, n, FLAT_GRAIN, fresh ? scaled_range_best() : scaled_add_range_best(),
                 &(flat_job){.a = from, .y = to, .factor = factor});
}

sherf_status cpu_add_forward(op_call *call) {
    flat_job j = {call->in[0]->data, call->in[1]->data, call->out[0]->data, 0};
    parallel_for(call->c, tensor_count(call->out[0]), FLAT_GRAIN, sum_range_best(), &j);
    return SHERF_OK;
}

sherf_status cpu_add_backward(op_call *call) {
    for (int k = 0; k < 2; k++)
        if (call->din[k])
            cpu_add_scaled(call->c, tensor_count(call->out[0]), 1, call->dout[0]->data, call->fresh[k],
                           call->din[k]->data);
    return SHERF_OK;
}

sherf_status cpu_scale_forward(op_call *call) {
    flat_job j = {call->in[0]->data, NULL, call->out[0]->data, *(const float *)call->attr};
    parallel_for(call->c, tensor_count(call->out[0]), FLAT_GRAIN, scaled_range_best(), &j);
    return SHERF_OK;
}

sherf_status cpu_scale_backward(op_call *call) {
    cpu_add_scaled(call->c, tensor_count(call->out[0]), *(const float *)call->attr, call->dout[0]->data,
                   call->fresh[0], call->din[0]->data);
    return SHERF_OK;
}

/* ---- mask_rows ---- */
typedef struct {
    const float *from;
    float *to;
    const int32_t *mask;
    int64_t C;
} mask_job;

static void mask_forward(void *arg, int64_t begin, int64_t end, int thread) {
    const mask_job *j = arg;
    const size_t bytes = (size_t)j->C * sizeof(float);
    for (int64_t r = begin; r < end; r++) {
        if (j->mask[r])
            memcpy(j->to + r * j->C, j->from + r * j->C, bytes);
        else
            memset(j->to + r * j->C, 0, bytes);
    }
}

static void mask_backward(void *arg, int64_t begin, int64_t end, int thread) {
    const mask_job *j = arg;
    for (int64_t r = begin; r < end; r++)
        for (int64_t i = r * j->C; j->mask[r] && i < (r + 1) * j->C; i++) j->to[i] += j->from[i];
}

sherf_status cpu_mask_rows_forward(op_call *call) {
    mask_job j = {call->in[0]->data, call->out[0]->data, call->in[1]->data, tensor_columns(call->in[0])};
    parallel_for(call->c, tensor_rows(call->in[0]), 512, mask_forward, &j);
    return SHERF_OK;
}

sherf_status cpu_mask_rows_backward(op_call *call) {
    mask_job j = {call->dout[0]->data, call->din[0]->data, call->in[1]->data, tensor_columns(call->in[0])};
    parallel_for(call->c, tensor_rows(call->in[0]), 512, mask_backward, &j);
    return SHERF_OK;
}
