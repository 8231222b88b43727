/* Layer norm, attention among tokens, activations and the positional encoding. */
#include <math.h>

#include "tensor/cpu/spatial_kernels.h"
#include "tensor/ref/ref.h"

enum { GRAIN = 1024 }; /* rows or points worth a thread; elements: 16 times that */

static norm_work norm_of(op_call *call) {
    return (norm_work){
        .rows = tensor_rows(call->in[0]),
        .columns = tensor_columns(call->in[0]),
        .x = input(call, 0),
        .weight = input(call, 1),
        .bias = input(call, 2),
    };
}

sherf_status cpu_layer_norm_forward(op_call *call) {
    norm_work k = norm_of(call);
    k.y = call->out[0]->data;
    parallel_for(call->c, k.rows, GRAIN, spatial_best()->norm, &k);
    return SHERF_OK;
}

sherf_status cpu_layer_norm_backward(op_call *call) {
    norm_work k = norm_of(call);
    const int64_t C = k.columns;
    k.part = GRAIN / 2 > k.rows / 64 ? GRAIN / 2 : k.rows / 64; /* the split depends only on the shape */
    const int64_t parts = (k.rows + k.part - 1) / k.part;
    k.sums = arena_alloc(call->c, call->scratch, (size_t)(parts * 2 * C), sizeof *k.sums);
    if (!k.sums) return SHERF_NO_MEMORY;
    k.dy = call->dout[0]->data;
    k.dx = input_gradient(call, 0);
    parallel_for(call->c, parts, 1, spatial_best()->norm_back, &k);
    for (int i = 1; i <= 2; i++) {
        float *to = input_gradient(call, i);
        for (int64_t part = 0; to && part < parts; part++)
            for (int64_t c = 0; c < C; c++) to[c] += k.sums[(2 * part + i - 1) * C + c];
    }
    return SHERF_OK;
}

/* The paper's shape, 3 tokens and heads of 16, is fast; others use the reference. */
static bool attention_fits(const attention_attr *a) {
    return a->tokens == 3 && a->width == 16 && a->heads <= 4;
}
static attention_work attention_of(op_call *call) {
    const attention_attr *a = call->attr;
    return (attention_work){.heads = a->heads, .scale = 1 / sqrtf((float)a->width), .qkv = input(call, 0)};
}

sherf_status cpu_token_attention_forward(op_call *call) {
    if (!attention_fits(call->attr)) return ref_token_attention_forward_f32(call);
    attention_work k = attention_of(call);
    k.y = call->out[0]->data;
    parallel_for(call->c, tensor_rows(call->in[0]) / 3, GRAIN / 4, spatial_best()->attention, &k);
    return SHERF_OK;
}

sherf_status cpu_token_attention_backward(op_call *call) {
    if (!attention_fits(call->attr)) return ref_token_attention_backward_f32(call);
    if (!call->din[0]) return SHERF_OK;
    attention_work k = attention_of(call);
    k.dy = call->dout[0]->data;
    k.dqkv = input_gradient(call, 0);
    parallel_for(call->c, tensor_rows(call->in[0]) / 3, GRAIN / 4, spatial_best()->attention_back, &k);
    return SHERF_OK;
}

static sherf_status map_forward(op_call *call, range_function f, float gain, float offset) {
    map_work k = {.x = input(call, 0), .y = call->out[0]->data, .gain = gain, .offset = offset};
    parallel_for(call->c, tensor_count(call->in[0]), 16 * GRAIN, f, &k);
    return SHERF_OK;
}
static sherf_status map_backward(op_call *call, range_function f, float gain) {
    if (!call->din[0]) return SHERF_OK;
    map_work k = {
        .x = input(call, 0), .dy = call->dout[0]->data, .dx = input_gradient(call, 0), .gain = gain};
    parallel_for(call->c, tensor_count(call->in[0]), 16 * GRAIN, f, &k);
    return SHERF_OK;
}

sherf_status cpu_gelu_forward(op_call *call) {
    return map_forward(call, spatial_best()->gelu, 1, 0);
}
sherf_status cpu_gelu_backward(op_call *call) {
    return map_backward(call, spatial_best()->gelu_back, 1);
}
sherf_status cpu_sigmoid_forward(op_call *call) {
    const sigmoid_attr *a = call->attr;
    return map_forward(call, spatial_best()->sigmoid, a->gain, a->offset);
}
sherf_status cpu_sigmoid_backward(op_call *call) {
    const sigmoid_attr *a = call->attr;
    return map_backward(call, spatial_best()->sigmoid_back, a->gain);
}

sherf_status cpu_positional_encode_forward(op_call *call) {
    const encode_attr *a = call->attr;
    encode_work k = {.columns = tensor_columns(call->in[0]),
                     .width = a->width,
                     .frequencies = a->frequencies,
                     .x = input(call, 0),
                     .y = call->out[0]->data};
    float largest = 0;
    for (int64_t i = 0, n = tensor_count(call->in[0]); i < n; i++)
        largest = fabsf(k.x[i]) <= largest ? largest : fabsf(k.x[i]);
    /* the fast sine's reduction has few bits to spare; NaN takes this path as well */
    if (!(largest * (float)(1 << a->frequencies) < 8000) || k.columns > 1024)
        return ref_positional_encode_forward_f32(call);
    parallel_for(call->c, tensor_rows(call->in[0]), GRAIN, spatial_best()->encode, &k);
    return SHERF_OK;
}
