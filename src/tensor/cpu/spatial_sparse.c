/* Sparse convolution: on AMX tiles in bf16; in float32 as register-blocked products over a tap's pairs
 * (output row, input row), so that empty taps cost nothing. In float32, channels are padded to a multiple of
 * SPARSE_PANEL. */
#include <string.h>

#include "tensor/cpu/amx_sparse.h"
#include "tensor/cpu/spatial_kernels.h"

static int64_t panels(int64_t channels) {
    return (channels + SPARSE_PANEL - 1) / SPARSE_PANEL;
}

static float *floats(op_call *call, int64_t count) {
    return arena_alloc(call->c, call->scratch, (size_t)count, sizeof(float));
}

/* x[R, C] with C padded by zeros, or x itself if no padding is needed. */
static const float *padded(op_call *call, const tensor *x) {
    const int64_t R = x->dim[0], C = x->dim[1], wide = panels(C) * SPARSE_PANEL;
    if (wide == C) return x->data;
    float *p = floats(call, R * wide);
    if (!p) return NULL;
    memset(p, 0, (size_t)(R * wide) * sizeof *p);
    for (int64_t r = 0; r < R; r++) memcpy(p + r * wide, tensor_f32(x) + r * C, (size_t)C * sizeof *p);
    return p;
}

/* Weights for sparse_rows: [27, panels of outputs, inputs, PANEL] of w [O, 27, I]; `back`: outputs are I and
 * inputs are O. */
typedef struct {
    const float *w;
    float *packed;
    int64_t I, O;
    bool back;
} pack_work;

static void pack_taps(void *arg, int64_t begin, int64_t end, int thread) {
    const pack_work *k = arg;
    const int64_t I = k->I, O = k->O, in = panels(k->back ? O : I) * SPARSE_PANEL;
    const int64_t out = panels(k->back ? I : O) * SPARSE_PANEL;
    for (int64_t tap = begin; tap < end; tap++) {
        float *to = k->packed + tap * in * out;
        if (in * out != I * O) memset(to, 0, (size_t)(in * out) * sizeof *to);
        for (int64_t o = 0; o < O; o++)
            for (int64_t i = 0; i < I; i++) {
                const int64_t row = k->back ? o : i, column = k->back ? i : o;
                to[(column / SPARSE_PANEL * in + row) * SPARSE_PANEL + column % SPARSE_PANEL] =
                    k->w[(o * SPARSE_TAPS + tap) * I + i];
            }
    }
}

/* y[rows, outputs] += the convolution of x by `rule` */
static sherf_status add_rows(op_call *call, const tensor *x, const int32_t *rule, bool back, tensor *y) {
    const tensor *w = call->in[1];
    const int64_t R = y->dim[0], C = y->dim[1];
    sparse_work k = {
        .inputs = panels(x->dim[1]) * SPARSE_PANEL, .outputs = panels(C) * SPARSE_PANEL, .rule = rule};
    pack_work pack = {.w = w->data, .I = w->dim[4], .O = w->dim[0], .back = back};
    k.weight = pack.packed = floats(call, SPARSE_TAPS * k.inputs * k.outputs);
    k.x = padded(call, x);
    k.y = k.outputs == C ? y->data : floats(call, R * k.outputs);
    if (!pack.packed || !k.x || !k.y) return SHERF_NO_MEMORY;
    parallel_for(call->c, SPARSE_TAPS, 1, pack_taps, &pack);
    if (k.outputs != C) memset(k.y, 0, (size_t)(R * k.outputs) * sizeof *k.y);
    parallel_for(call->c, R, 32, spatial_best()->sparse_rows, &k);
    for (int64_t r = 0; k.outputs != C && r < R; r++)
        for (int64_t c = 0; c < C; c++) tensor_f32(y)[r * C + c] += k.y[r * k.outputs + c];
    return SHERF_OK;
}

static bool is_amx(const op_call *call) {
    return call->bf16 && isa_has_bf16() && amx_sparse_fits(call->in[1]);
}

sherf_status cpu_sparse_conv_forward(op_call *call) {
    tensor *y = call->out[0];
    if (is_amx(call)) return amx_sparse_rows(call, call->in[0], call->in[2]->data, false, false, y);
    memset(y->data, 0, (size_t)tensor_count(y) * sizeof(float));
    return add_rows(call, call->in[0], call->in[2]->data, false, y);
}

/* The rule from the inputs' side: [inputs, 27], the output row that takes the input at this tap. */
static sherf_status rule_transpose(op_call *call, int32_t **transposed) {
    const tensor *rule = call->in[2];
    const int64_t R = call->in[0]->dim[0];
    const int32_t *from = rule->data;
    int32_t *t = arena_alloc(call->c, call->scratch, (size_t)(R * SPARSE_TAPS), sizeof *t);
    if (!t) return SHERF_NO_MEMORY;
    memset(t, 0xff, (size_t)(R * SPARSE_TAPS) * sizeof *t);
    for (int64_t a = 0; a < rule->dim[0]; a++)
        for (int64_t tap = 0; tap < SPARSE_TAPS; tap++) {
            const int64_t r = from[a * SPARSE_TAPS + tap];
            if (r < 0) continue;
            if (t[r * SPARSE_TAPS + tap] >= 0)
                return failure(call->c, SHERF_BAD_ARGUMENT,
                               "sparse_conv: a tap of the rule reads row %lld twice", (long long)r);
            t[r * SPARSE_TAPS + tap] = (int32_t)a;
        }
    *transposed = t;
    return SHERF_OK;
}

/* Every tap's pairs, one after another. */
static sherf_status pairs_list(op_call *call, sparse_work *k) {
    const tensor *rule = call->in[2];
    const int64_t A = rule->dim[0];
    int64_t *begin = arena_alloc(call->c, call->scratch, SPARSE_TAPS + 1, sizeof *begin);
    if (!begin) return SHERF_NO_MEMORY;
    memset(begin, 0, (SPARSE_TAPS + 1) * sizeof *begin);
    for (int64_t j = 0; j < A * SPARSE_TAPS; j++)
        if (tensor_i32(rule)[j] >= 0) begin[j % SPARSE_TAPS + 1]++;
    for (int tap = 0; tap < SPARSE_TAPS; tap++) begin[tap + 1] += begin[tap];
    sparse_pair *pair = arena_alloc(call->c, call->scratch, (size_t)begin[SPARSE_TAPS], sizeof *pair);
    if (!pair) return SHERF_NO_MEMORY;
    int64_t next[SPARSE_TAPS];
    memcpy(next, begin, sizeof next);
    for (int64_t j = 0; j < A * SPARSE_TAPS; j++)
        if (tensor_i32(rule)[j] >= 0)
            pair[next[j % SPARSE_TAPS]++] = (sparse_pair){(int32_t)(j / SPARSE_TAPS), tensor_i32(rule)[j]};
    k->pair = pair;
    k->pairs = begin;
    return SHERF_OK;
}

static sherf_status add_weights(op_call *call, tensor *dw) {
    const int64_t O = dw->dim[0], I = dw->dim[4];
    sparse_work k = {.inputs = panels(I) * SPARSE_PANEL, .outputs = panels(O) * SPARSE_PANEL};
    const bool pad = k.inputs != I || k.outputs != O;
    k.x = padded(call, call->in[0]);
    k.dy = padded(call, call->dout[0]);
    k.dw = pad ? floats(call, k.outputs * SPARSE_TAPS * k.inputs) : dw->data;
    if (!k.x || !k.dy || !k.dw) return SHERF_NO_MEMORY;
    if (pad) memset(k.dw, 0, (size_t)(k.outputs * SPARSE_TAPS * k.inputs) * sizeof *k.dw);
    sherf_status status = pairs_list(call, &k);
    if (status != SHERF_OK) return status;
    parallel_for(call->c, k.outputs / SPARSE_ROWS * SPARSE_TAPS, 1, spatial_best()->sparse_weights, &k);
    for (int64_t r = 0; pad && r < O * SPARSE_TAPS; r++)
        for (int64_t i = 0; i < I; i++) tensor_f32(dw)[r * I + i] += k.dw[r * k.inputs + i];
    return SHERF_OK;
}

static sherf_status backward_data(op_call *call) {
    int32_t *rule = NULL;
    sherf_status status = rule_transpose(call, &rule);
    if (status != SHERF_OK) return status;
    tensor *dx = call->din[0];
    if (is_amx(call)) return amx_sparse_rows(call, call->dout[0], rule, true, !call->fresh[0], dx);
    if (call->fresh[0]) memset(dx->data, 0, (size_t)tensor_count(dx) * sizeof(float));
    return add_rows(call, call->dout[0], rule, true, dx);
}

static sherf_status backward_weights(op_call *call) {
    if (!is_amx(call)) return add_weights(call, call->din[1]);
    return amx_sparse_weights(call, call->in[0], call->in[2]->data, call->dout[0], call->din[1]);
}

sherf_status cpu_sparse_conv_backward(op_call *call) {
    const arena_mark mark = arena_position(call->scratch);
    sherf_status status = call->din[0] ? backward_data(call) : SHERF_OK;
    arena_rewind(call->scratch, mark);
    return status == SHERF_OK && call->din[1] ? backward_weights(call) : status;
}
