/* concat and slice: copy columns of rows, or add them in the backward pass. */
#include <string.h>

#include "tensor/cpu/cpu.h"

typedef struct {
    const float *from;
    float *to;
    int64_t width, from_step, to_step; /* in values */
} columns_job;

static void copy_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const columns_job *j = arg;
    for (int64_t r = begin; r < end; r++)
        memcpy(j->to + r * j->to_step, j->from + r * j->from_step, (size_t)j->width * sizeof(float));
}

static void add_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const columns_job *j = arg;
    for (int64_t r = begin; r < end; r++) {
        const float *restrict from = j->from + r * j->from_step;
        float *restrict to = j->to + r * j->to_step;
        for (int64_t i = 0; i < j->width; i++) to[i] += from[i];
    }
}

enum { ROW_GRAIN = 512 };

sherf_status cpu_concat_forward(op_call *call) {
    const int64_t C = tensor_columns(call->out[0]);
    float *y = call->out[0]->data;
    for (int k = 0; k < OP_MAX_IN && call->in[k]; k++) {
        const int64_t width = tensor_columns(call->in[k]);
        columns_job j = {call->in[k]->data, y, width, width, C};
        parallel_for(call->c, tensor_rows(call->out[0]), ROW_GRAIN, copy_rows, &j);
        y += width;
    }
    return SHERF_OK;
}

sherf_status cpu_concat_backward(op_call *call) {
    const int64_t C = tensor_columns(call->out[0]);
    const float *dy = call->dout[0]->data;
    for (int k = 0; k < OP_MAX_IN && call->in[k]; k++) {
        const int64_t width = tensor_columns(call->in[k]);
        if (call->din[k]) {
            columns_job j = {dy, call->din[k]->data, width, C, width};
            parallel_for(call->c, tensor_rows(call->out[0]), ROW_GRAIN, add_rows, &j);
        }
        dy += width;
    }
    return SHERF_OK;
}

sherf_status cpu_slice_forward(op_call *call) {
    const slice_attr *a = call->attr;
    columns_job j = {tensor_f32(call->in[0]) + a->begin, call->out[0]->data, a->width,
                     tensor_columns(call->in[0]), a->width};
    parallel_for(call->c, tensor_rows(call->in[0]), ROW_GRAIN, copy_rows, &j);
    return SHERF_OK;
}

sherf_status cpu_slice_backward(op_call *call) {
    const slice_attr *a = call->attr;
    columns_job j = {call->dout[0]->data, tensor_f32(call->din[0]) + a->begin, a->width, a->width,
                     tensor_columns(call->in[0])};
    parallel_for(call->c, tensor_rows(call->in[0]), ROW_GRAIN, add_rows, &j);
    return SHERF_OK;
}
