/* batch_norm: statistics in one pass over memory (a block's mean, then its squares about that mean while it
 * is in the cache; blocks are joined in double), then one pass that normalises. The mean is kept as two
 * floats: with one, its rounding shifts a whole channel, by more than the products' rounding if the mean is
 * large compared with the deviation. */
#include <math.h>
#include <string.h>

#include "tensor/cpu/rows.h"
#include "tensor/cpu/variants.h"

typedef struct {
    row_view view;
    bool relu, training, fresh; /* fresh: dx is cleared row by row, in the L1 cache */
    const float *x, *dy;
    float *y, *dx, *sums;
    float *mean, *rest, *scale, *bias; /* patterns: y = (x - mean - rest) scale + bias */
    float *shift, *slope;              /* backward: dx += scale (g - shift - slope (x - mean - rest)) */
} norm_job;

/* sums: the block's mean, then the sum of squares about it, for every column of the view. */
static VARIANT_BODY void statistics(void *arg, int64_t begin, int64_t end, int thread) {
    const norm_job *j = arg;
    const row_view *v = &j->view;
    for (int64_t block = begin; block < end; block++) {
        const int64_t first = block * v->block_rows;
        const int64_t last = first + v->block_rows < v->rows ? first + v->block_rows : v->rows;
        float *restrict mean = j->sums + block * 2 * v->width, *restrict squares = mean + v->width;
        memset(mean, 0, 2 * (size_t)v->width * sizeof *mean);
        for (int64_t r = first; r < last; r++) {
            const float *restrict x = j->x + r * v->width;
            const int64_t n = row_width(v, r);
            for (int64_t i = 0; i < n; i++) mean[i] += x[i];
        }
        for (int64_t i = 0; i < v->width; i++) {
            const int64_t rows = last - first - (i >= row_width(v, last - 1));
            mean[i] = rows ? mean[i] / (float)rows : 0;
        }
        for (int64_t r = first; r < last; r++) {
            const float *restrict x = j->x + r * v->width;
            const int64_t n = row_width(v, r);
            for (int64_t i = 0; i < n; i++) squares[i] += (x[i] - mean[i]) * (x[i] - mean[i]);
        }
    }
}
VARIANTS(statistics)

/* Joins the blocks' means and squares of channel c (Chan et al.): mean and the sum of squares over all rows.
 */
static void statistics_join(const norm_job *j, int64_t c, double *mean, double *squares) {
    const row_view *v = &j->view;
    double count = 0, m = 0, s = 0;
    for (int64_t block = 0; block < v->blocks; block++) {
        const int64_t first = block * v->block_rows;
        const int64_t last = first + v->block_rows < v->rows ? first + v->block_rows : v->rows;
        const float *means = j->sums + block * 2 * v->width;
        for (int64_t i = c; i < v->width; i += v->channels) {
            const double n = (double)(last - first - (i >= row_width(v, last - 1)));
            if (n == 0) continue;
            const double d = means[i] - m;
            count += n;
            m += d * n / count;
            s += means[v->width + i] + d * d * n * (count - n) / count;
        }
    }
    *mean = m;
    *squares = s;
}

static VARIANT_BODY void normalise(void *arg, int64_t begin, int64_t end, int thread) {
    const norm_job *j = arg;
    const float *restrict mean = j->mean, *restrict rest = j->rest;
    const float *restrict scale = j->scale, *restrict bias = j->bias;
    const float low = j->relu ? 0 : -__builtin_inff();
    for (int64_t r = begin; r < end; r++) {
        const int64_t n = row_width(&j->view, r);
        const float *restrict x = j->x + r * j->view.width;
        float *restrict y = j->y + r * j->view.width;
        for (int64_t i = 0; i < n; i++) {
            const float v = ((x[i] - mean[i]) - rest[i]) * scale[i] + bias[i];
            y[i] = v < low ? low : v;
        }
    }
}
VARIANTS(normalise)

/* Computes the job's mean, scale and bias from the saved statistics. */
static bool patterns(op_call *call, norm_job *j) {
    const float *weight = call->in[1]->data, *mean = call->saved, *inverse = mean + j->view.channels;
    j->mean = row_pattern(call, &j->view, mean);
    j->rest = row_pattern(call, &j->view, inverse + j->view.channels);
    j->scale = row_pattern(call, &j->view, inverse);
    j->bias = row_pattern(call, &j->view, call->in[2]->data);
    if (!j->mean || !j->rest || !j->scale || !j->bias) return false;
    for (int64_t i = 0; i < j->view.width; i++) j->scale[i] *= weight[i % j->view.channels];
    return true;
}

sherf_status cpu_batch_norm_forward(op_call *call) {
    const batch_norm_attr *a = call->attr;
    const double R = (double)tensor_rows(call->in[0]);
    norm_job j = {.view = rows_of(call->in[0]), .relu = a->relu, .training = call->training};
    j.x = call->in[0]->data;
    j.y = call->out[0]->data;
    float *running_mean = call->in[3]->data, *running_var = call->in[4]->data;
    float *mean = call->saved, *inverse = mean + j.view.channels, *rest = inverse + j.view.channels;
    if (call->training) {
        if (!(j.sums = block_sums(call, &j.view, 2))) return SHERF_NO_MEMORY;
        parallel_for(call->c, j.view.blocks, 1, statistics_best(), &j);
    }
    for (int64_t c = 0; c < j.view.channels; c++) {
        double m = running_mean[c], variance = running_var[c];
        if (call->training) {
            statistics_join(&j, c, &m, &variance);
            running_mean[c] += (float)(a->momentum * (m - running_mean[c]));
            running_var[c] += (float)(a->momentum * (variance / (R > 1 ? R - 1 : 1) - running_var[c]));
            variance /= R;
        }
        mean[c] = (float)m;
        rest[c] = (float)(m - (double)mean[c]);
        inverse[c] = (float)(1 / sqrt(variance + (double)a->eps));
    }
    if (!patterns(call, &j)) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.rows, row_grain(&j.view), normalise_best(), &j);
    return SHERF_OK;
}

/* sums: g and g (x - mean); g is dy where the ReLU passes. */
static VARIANT_BODY void gradient_sums(void *arg, int64_t begin, int64_t end, int thread) {
    const norm_job *j = arg;
    const row_view *v = &j->view;
    const float *restrict mean = j->mean, *restrict rest = j->rest;
    const float *restrict scale = j->scale, *restrict bias = j->bias;
    const float low = j->relu ? 0 : -__builtin_inff();
    for (int64_t block = begin; block < end; block++) {
        float *restrict sum = j->sums + block * 2 * v->width, *restrict dot = sum + v->width;
        memset(sum, 0, 2 * (size_t)v->width * sizeof *sum);
        for (int64_t r = block * v->block_rows; r < v->rows && r < (block + 1) * v->block_rows; r++) {
            const int64_t n = row_width(v, r);
            const float *restrict x = j->x + r * v->width, *restrict dy = j->dy + r * v->width;
#pragma omp simd /* without it the choice becomes a branch that is mispredicted half of the time */
            for (int64_t i = 0; i < n; i++) {
                const float d = (x[i] - mean[i]) - rest[i], whole = dy[i];
                const float g = d * scale[i] + bias[i] > low ? whole : 0;
                sum[i] += g;
                dot[i] += g * d;
            }
        }
    }
}
VARIANTS(gradient_sums)

static VARIANT_BODY void gradient_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const norm_job *j = arg;
    const float *restrict mean = j->mean, *restrict rest = j->rest;
    const float *restrict scale = j->scale, *restrict bias = j->bias;
    const float *restrict shift = j->shift, *restrict slope = j->slope;
    const float low = j->relu ? 0 : -__builtin_inff();
    for (int64_t r = begin; r < end; r++) {
        const int64_t n = row_width(&j->view, r);
        const float *restrict x = j->x + r * j->view.width, *restrict dy = j->dy + r * j->view.width;
        float *restrict dx = j->dx + r * j->view.width;
        if (j->fresh) memset(dx, 0, (size_t)n * sizeof *dx);
        for (int64_t i = 0; i < n; i++) {
            const float d = (x[i] - mean[i]) - rest[i], g = d * scale[i] + bias[i] > low ? dy[i] : 0;
            dx[i] += scale[i] * (g - shift[i] - slope[i] * d);
        }
    }
}
VARIANTS(gradient_rows)

/* With n = (x - mean) k: dbias = sum g, dweight = k sum g (x - mean);
 * dx = weight k (g - mean g - n mean(g n)) for batch statistics, weight k g for running ones. */
sherf_status cpu_batch_norm_backward(op_call *call) {
    const batch_norm_attr *a = call->attr;
    norm_job j = {.view = rows_of(call->in[0]), .relu = a->relu, .training = call->training};
    const int64_t C = j.view.channels;
    const float R = (float)tensor_rows(call->in[0]), *inverse = (const float *)call->saved + C;
    j.x = call->in[0]->data;
    j.dy = call->dout[0]->data;
    j.dx = call->din[0] ? call->din[0]->data : NULL;
    j.fresh = call->fresh[0];
    j.sums = block_sums(call, &j.view, 2);
    float *sum = arena_alloc(call->c, call->scratch, 2 * (size_t)C, sizeof *sum), *dot = sum + C;
    if (!patterns(call, &j) || !j.sums || !sum) return SHERF_NO_MEMORY;
    memset(sum, 0, 2 * (size_t)C * sizeof *sum);
    parallel_for(call->c, j.view.blocks, 1, gradient_sums_best(), &j);
    block_sums_add(&j.view, j.sums, 2, 0, 1, sum);
    block_sums_add(&j.view, j.sums, 2, 1, 1, dot);
    for (int64_t c = 0; c < C; c++) {
        if (call->din[1]) tensor_f32(call->din[1])[c] += dot[c] * inverse[c];
        if (call->din[2]) tensor_f32(call->din[2])[c] += sum[c];
        sum[c] = call->training ? sum[c] / R : 0;
        dot[c] = call->training ? dot[c] * inverse[c] * inverse[c] / R : 0;
    }
    if (!j.dx) return SHERF_OK;
    j.shift = row_pattern(call, &j.view, sum);
    j.slope = row_pattern(call, &j.view, dot);
    if (!j.shift || !j.slope) return SHERF_NO_MEMORY;
    parallel_for(call->c, j.view.rows, row_grain(&j.view), gradient_rows_best(), &j);
    return SHERF_OK;
}
