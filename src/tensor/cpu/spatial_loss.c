/* Compositing and the losses. Sums over pixels run in parts that depend only on the shape, then over the
 * parts. */
#include <math.h>
#include <string.h>

#include "tensor/cpu/spatial_kernels.h"

static sherf_status composite_run(op_call *call, range_function f, const float *dy) {
    const int64_t N = tensor_count(call->in[4]);
    composite_work k = {
        .attr = *(const composite_attr *)call->attr,
        .sigma = input(call, 0),
        .rgb = input(call, 1),
        .first = call->in[2]->data,
        .sample = call->in[3]->data,
        .near = input(call, 4),
        .far = input(call, 5),
        .length = input(call, 6),
        .at = call->in[7] ? input(call, 7) : NULL,
        .dy = dy,
        .y = call->out[0]->data,
        .dsigma = input_gradient(call, 0),
        .drgb = input_gradient(call, 1),
        .longest = 16,
    };
    for (int64_t n = 0; n < N; n++)
        if (k.first[n + 1] - k.first[n] > k.longest) k.longest = (k.first[n + 1] - k.first[n] + 15) / 16 * 16;
    k.scratch =
        arena_alloc(call->c, call->scratch, (size_t)(call->c->threads * 3 * k.longest), sizeof(float));
    if (!k.scratch) return SHERF_NO_MEMORY;
    parallel_for(call->c, N, 256, f, &k);
    return SHERF_OK;
}

sherf_status cpu_composite_forward(op_call *call) {
    return composite_run(call, spatial_best()->composite, NULL);
}
sherf_status cpu_composite_backward(op_call *call) {
    return composite_run(call, spatial_best()->composite_back, call->dout[0]->data);
}

/* Runs f over fixed parts of the rows and adds the parts' sums. */
static sherf_status loss_sum(op_call *call, loss_work *k, range_function f, double *sum, int64_t *count) {
    k->part = 256 > k->rows / 64 ? 256 : k->rows / 64;
    const int64_t parts = (k->rows + k->part - 1) / k->part;
    k->sum = arena_alloc(call->c, call->scratch, (size_t)parts, sizeof *k->sum);
    k->count = arena_alloc(call->c, call->scratch, (size_t)parts, sizeof *k->count);
    if (!k->sum || !k->count) return SHERF_NO_MEMORY;
    memset(k->count, 0, (size_t)parts * sizeof *k->count);
    parallel_for(call->c, parts, 1, f, k);
    *sum = 0;
    *count = 0;
    for (int64_t p = 0; p < parts; p++) {
        *sum += k->sum[p];
        *count += k->count[p];
    }
    return SHERF_OK;
}

static loss_work loss_of(op_call *call) {
    return (loss_work){
        .rows = tensor_rows(call->in[0]),
        .columns = tensor_columns(call->in[0]),
        .a = input(call, 0),
        .b = input(call, 1),
    };
}

sherf_status cpu_mean_square_forward(op_call *call) {
    loss_work k = loss_of(call);
    double sum;
    int64_t count;
    if (call->in[2]) k.mask = call->in[2]->data;
    sherf_status status = loss_sum(call, &k, spatial_best()->square, &sum, &count);
    if (status != SHERF_OK) return status;
    tensor_f32(call->out[0])[0] = count && k.columns ? (float)(sum / (double)(count * k.columns)) : 0;
    return SHERF_OK;
}

sherf_status cpu_mean_square_backward(op_call *call) {
    loss_work k = loss_of(call);
    if (!call->din[0]) return SHERF_OK;
    if (call->in[2]) k.mask = call->in[2]->data;
    int64_t count = 0;
    for (int64_t r = 0; r < k.rows; r++) count += !k.mask || k.mask[r] != 0;
    if (!count || !k.columns) return SHERF_OK;
    k.scale = 2 * tensor_f32(call->dout[0])[0] / (float)(count * k.columns);
    k.da = input_gradient(call, 0);
    parallel_for(call->c, k.rows, 4096, spatial_best()->square_back, &k);
    return SHERF_OK;
}

sherf_status cpu_feature_distance_forward(op_call *call) {
    loss_work k = loss_of(call);
    double sum;
    int64_t count;
    k.head = input(call, 2);
    sherf_status status = loss_sum(call, &k, spatial_best()->distance, &sum, &count);
    if (status != SHERF_OK) return status;
    tensor_f32(call->out[0])[0] = (float)(sum / (double)k.rows);
    return SHERF_OK;
}

sherf_status cpu_feature_distance_backward(op_call *call) {
    loss_work k = loss_of(call);
    if (!call->din[0]) return SHERF_OK;
    k.head = input(call, 2);
    k.scale = tensor_f32(call->dout[0])[0] / (float)k.rows;
    k.da = input_gradient(call, 0);
    parallel_for(call->c, k.rows, 256, spatial_best()->distance_back, &k);
    return SHERF_OK;
}

static sherf_status ssim_of(op_call *call, ssim_work *k) {
    const tensor *x = call->in[0];
    *k = (ssim_work){.height = x->dim[0],
                     .row = x->dim[1] * x->dim[2],
                     .channels = x->dim[2],
                     .x = input(call, 0),
                     .y = input(call, 1)};
    double total = 0, g[11];
    for (int i = 0; i < 11; i++) total += g[i] = exp(-(i - 5) * (i - 5) / (2 * 1.5 * 1.5));
    for (int i = 0; i < 11; i++) k->window[i] = (float)(g[i] / total);
    k->scratch = arena_alloc(call->c, call->scratch,
                             (size_t)(call->c->threads * 5 * (k->row + 20 * k->channels)), sizeof(float));
    return k->scratch ? SHERF_OK : SHERF_NO_MEMORY;
}

sherf_status cpu_ssim_forward(op_call *call) {
    ssim_work k;
    sherf_status status = ssim_of(call, &k);
    if (status != SHERF_OK) return status;
    const int64_t rows = k.height - 10;
    k.sum = arena_alloc(call->c, call->scratch, (size_t)rows, sizeof *k.sum);
    if (!k.sum) return SHERF_NO_MEMORY;
    parallel_for(call->c, rows, 8, spatial_best()->ssim_statistics, &k);
    double sum = 0;
    for (int64_t r = 0; r < rows; r++) sum += k.sum[r];
    tensor_f32(call->out[0])[0] = (float)(sum / (double)(rows * (k.row - 10 * k.channels)));
    return SHERF_OK;
}

sherf_status cpu_ssim_backward(op_call *call) {
    ssim_work k;
    if (!call->din[0]) return SHERF_OK;
    sherf_status status = ssim_of(call, &k);
    if (status != SHERF_OK) return status;
    const int64_t windows = (k.height - 10) * (k.row - 10 * k.channels);
    k.by = arena_alloc(call->c, call->scratch, 3 * (size_t)windows, sizeof *k.by);
    if (!k.by) return SHERF_NO_MEMORY;
    parallel_for(call->c, k.height - 10, 8, spatial_best()->ssim_statistics, &k);
    k.scale = tensor_f32(call->dout[0])[0] / (float)windows;
    k.dx = input_gradient(call, 0);
    parallel_for(call->c, k.height, 8, spatial_best()->ssim_gradient, &k);
    return SHERF_OK;
}
