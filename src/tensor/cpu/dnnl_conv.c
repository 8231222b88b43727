/* conv2d and conv2d_transpose through oneDNN. Activations stay channels-last. The weights (OIHW) are packed
 * in each call, since nothing shows when a parameter has changed. In bf16 the inputs are rounded first; sums
 * and results are float32. */
#include <string.h>

#include "tensor/cpu/bf16.h"
#include "tensor/cpu/dnnl_conv.h"
#include "tensor/cpu/dnnl_plan.h"
#include "tensor/cpu/rows.h"

#define TRY(call)                                                                                            \
    do {                                                                                                     \
        dnnl_status_t status_ = (call);                                                                      \
        if (status_ != dnnl_success) return status_;                                                         \
    } while (0)

static int64_t out_size(const plan_key *k, int64_t n) {
    return k->transpose ? 2 * n + k->k - 2 : (n + 2 * k->pad - k->k) / k->stride + 1;
}

typedef struct {
    dnnl_memory_desc_t x, w, y;
} shapes;

/* The pass's result is float32; its inputs have the product's type. */
static dnnl_status_t shapes_init(shapes *s, const plan_key *k, int pass) {
    const dnnl_data_type_t type = k->bf16 ? dnnl_bf16 : dnnl_f32;
    const dnnl_dims_t x = {1, k->I, k->H, k->W}, w = {k->O, k->I, k->k, k->k};
    const dnnl_dims_t y = {1, k->O, out_size(k, k->H), out_size(k, k->W)};
    TRY(dnnl_memory_desc_init_by_tag(&s->x, 4, x, pass == PASS_DATA ? dnnl_f32 : type, dnnl_nhwc));
    TRY(dnnl_memory_desc_init_by_tag(&s->w, 4, w, pass == PASS_WEIGHTS ? dnnl_f32 : type,
                                     dnnl_format_tag_any));
    return dnnl_memory_desc_init_by_tag(&s->y, 4, y, pass == PASS_FORWARD ? dnnl_f32 : type, dnnl_nhwc);
}

static dnnl_status_t attr_create(dnnl_primitive_attr_t *attr) {
    TRY(dnnl_primitive_attr_create(attr));
    return dnnl_primitive_attr_set_scratchpad_mode(*attr, dnnl_scratchpad_mode_user);
}

/* Forward: y = gain * the convolution. The backward passes scale their result when they add it. */
static dnnl_status_t gain_attr(dnnl_primitive_attr_t attr, const plan_key *k) {
    if (k->pass != PASS_FORWARD || k->gain == 1) return dnnl_success;
    dnnl_post_ops_t ops;
    TRY(dnnl_post_ops_create(&ops));
    dnnl_status_t status = dnnl_post_ops_append_eltwise(ops, 1, dnnl_eltwise_linear, k->gain, 0);
    if (status == dnnl_success) status = dnnl_primitive_attr_set_post_ops(attr, ops);
    dnnl_post_ops_destroy(ops);
    return status;
}

static dnnl_status_t convolution_desc(dnnl_primitive_desc_t *out, const plan_key *k, int pass,
                                      const shapes *s, dnnl_primitive_attr_t attr, dnnl_engine_t engine,
                                      dnnl_primitive_desc_t hint) {
    dnnl_convolution_desc_t d;
    const dnnl_dims_t stride = {k->stride, k->stride}, pad = {k->pad, k->pad};
    if (pass == PASS_FORWARD)
        TRY(dnnl_convolution_forward_desc_init(&d, dnnl_forward_training, dnnl_convolution_direct, &s->x,
                                               &s->w, NULL, &s->y, stride, pad, pad));
    else if (pass == PASS_DATA)
        TRY(dnnl_convolution_backward_data_desc_init(&d, dnnl_convolution_direct, &s->x, &s->w, &s->y, stride,
                                                     pad, pad));
    else
        TRY(dnnl_convolution_backward_weights_desc_init(&d, dnnl_convolution_direct, &s->x, &s->w, NULL,
                                                        &s->y, stride, pad, pad));
    return dnnl_primitive_desc_create(out, &d, attr, engine, hint);
}

static dnnl_status_t transpose_desc(dnnl_primitive_desc_t *out, const plan_key *k, int pass, const shapes *s,
                                    dnnl_primitive_attr_t attr, dnnl_engine_t engine,
                                    dnnl_primitive_desc_t hint) {
    dnnl_deconvolution_desc_t d;
    const dnnl_dims_t stride = {2, 2}, pad = {0, 0};
    if (pass == PASS_FORWARD)
        TRY(dnnl_deconvolution_forward_desc_init(&d, dnnl_forward_training, dnnl_deconvolution_direct, &s->x,
                                                 &s->w, NULL, &s->y, stride, pad, pad));
    else if (pass == PASS_DATA)
        TRY(dnnl_deconvolution_backward_data_desc_init(&d, dnnl_deconvolution_direct, &s->x, &s->w, &s->y,
                                                       stride, pad, pad));
    else
        TRY(dnnl_deconvolution_backward_weights_desc_init(&d, dnnl_deconvolution_direct, &s->x, &s->w, NULL,
                                                          &s->y, stride, pad, pad));
    return dnnl_primitive_desc_create(out, &d, attr, engine, hint);
}

/* Builds p->main for the pass; oneDNN needs the forward pass's description for the backward ones. */
static dnnl_status_t main_build(plan *p, dnnl_engine_t engine, dnnl_primitive_attr_t attr) {
    const plan_key *k = &p->key;
    dnnl_status_t (*desc)(dnnl_primitive_desc_t *, const plan_key *, int, const shapes *,
                          dnnl_primitive_attr_t, dnnl_engine_t, dnnl_primitive_desc_t) =
        k->transpose ? transpose_desc : convolution_desc;
    shapes s;
    dnnl_primitive_desc_t hint = NULL;
    if (k->pass != PASS_FORWARD) {
        TRY(shapes_init(&s, k, PASS_FORWARD));
        TRY(desc(&hint, k, PASS_FORWARD, &s, NULL, engine, NULL));
    }
    dnnl_status_t status = shapes_init(&s, k, k->pass);
    if (status == dnnl_success) status = gain_attr(attr, k);
    if (status == dnnl_success) status = desc(&p->main_desc, k, k->pass, &s, attr, engine, hint);
    if (hint) dnnl_primitive_desc_destroy(hint);
    if (status == dnnl_success) status = dnnl_primitive_create(&p->main, p->main_desc);
    return status;
}

/* Packs the weights; after PASS_WEIGHTS unpacks them: dw += gain * packed. */
static dnnl_status_t weights_build(plan *p, dnnl_engine_t engine, dnnl_primitive_attr_t attr) {
    const plan_key *k = &p->key;
    const dnnl_dims_t w = {k->O, k->I, k->k, k->k};
    TRY(dnnl_memory_desc_init_by_tag(&p->w_plain, 4, w, dnnl_f32, dnnl_oihw));
    const bool back = k->pass == PASS_WEIGHTS;
    if (back) {
        dnnl_post_ops_t ops;
        TRY(dnnl_primitive_attr_set_output_scales(attr, 1, 0, &k->gain));
        TRY(dnnl_post_ops_create(&ops));
        dnnl_status_t status = dnnl_post_ops_append_sum(ops, 1);
        if (status == dnnl_success) status = dnnl_primitive_attr_set_post_ops(attr, ops);
        dnnl_post_ops_destroy(ops);
        TRY(status);
    }
    TRY(dnnl_reorder_primitive_desc_create(&p->weights_desc, back ? p->w : &p->w_plain, engine,
                                           back ? &p->w_plain : p->w, engine, attr));
    return dnnl_primitive_create(&p->weights, p->weights_desc);
}

static dnnl_status_t convolution_build(plan *p, dnnl_engine_t engine) {
    static const dnnl_query_t what[PASS_COUNT][3] = {
        {dnnl_query_src_md, dnnl_query_weights_md, dnnl_query_dst_md},
        {dnnl_query_diff_src_md, dnnl_query_weights_md, dnnl_query_diff_dst_md},
        {dnnl_query_src_md, dnnl_query_diff_weights_md, dnnl_query_diff_dst_md}};
    dnnl_primitive_attr_t attr = NULL;
    dnnl_status_t status = attr_create(&attr);
    if (status == dnnl_success) status = main_build(p, engine, attr);
    if (attr) dnnl_primitive_attr_destroy(attr);
    TRY(status);
    const dnnl_query_t *q = what[p->key.pass];
    p->x = dnnl_primitive_desc_query_md(p->main_desc, q[0], 0);
    p->w = dnnl_primitive_desc_query_md(p->main_desc, q[1], 0);
    p->y = dnnl_primitive_desc_query_md(p->main_desc, q[2], 0);
    p->scratch = dnnl_primitive_desc_query_md(p->main_desc, dnnl_query_scratchpad_md, 0);
    attr = NULL;
    status = attr_create(&attr);
    if (status == dnnl_success) status = weights_build(p, engine, attr);
    if (attr) dnnl_primitive_attr_destroy(attr);
    TRY(status);
    p->weights_scratch = dnnl_primitive_desc_query_md(p->weights_desc, dnnl_query_scratchpad_md, 0);
    return dnnl_success;
}

/* The plan in bf16 if requested and available, else in float32 (which oneDNN always has). */
static sherf_status plan_for(op_call *call, bool transpose, bool bf16, plan_pass pass, plan **out) {
    const tensor *x = call->in[0], *w = call->in[1];
    const conv2d_attr *a = transpose ? &(conv2d_attr){2, 0, 1} : call->attr;
    plan_key key = {.transpose = transpose, .pass = (int32_t)pass, .threads = call->c->threads};
    key.H = (int32_t)x->dim[0];
    key.W = (int32_t)x->dim[1];
    key.I = (int32_t)x->dim[2];
    key.O = (int32_t)w->dim[0];
    key.k = (int32_t)w->dim[2];
    key.stride = a->stride;
    key.pad = a->pad;
    key.gain = a->gain;
    key.bf16 = bf16;
    const int threads = threads_set(call->c->threads);
    sherf_status status = plan_acquire(call->c, &key, convolution_build, out);
    if (status == SHERF_UNSUPPORTED && key.bf16) {
        key.bf16 = 0;
        status = plan_acquire(call->c, &key, convolution_build, out);
    }
    threads_set(threads);
    if (status == SHERF_UNSUPPORTED)
        failure(call->c, status, "oneDNN has no convolution of %d x %d x %d to %d, kernel %d", key.H, key.W,
                key.I, key.O, key.k);
    return status;
}

/* An activation's values in the type that the plan reads. */
static void *activation(op_call *call, const plan *p, const tensor *t) {
    if (!p->key.bf16) return t->data;
    uint16_t *rounded = arena_alloc(call->c, call->scratch, (size_t)tensor_count(t), sizeof *rounded);
    if (rounded) bf16_round(call->c, tensor_f32(t), rounded, tensor_count(t));
    return rounded;
}

static void *packed_weights(op_call *call, const plan *p, const tensor *w) {
    void *packed = arena_alloc(call->c, call->scratch, dnnl_memory_desc_get_size(p->w), 1);
    if (!packed) return NULL;
    const plan_arg args[] = {{DNNL_ARG_FROM, &p->w_plain, w->data}, {DNNL_ARG_TO, p->w, packed}};
    return plan_run(call, p->weights, p->weights_scratch, 2, args) == SHERF_OK ? packed : NULL;
}

sherf_status dnnl_conv_forward(op_call *call, bool transpose, bool bf16) {
    plan *p;
    sherf_status status = plan_for(call, transpose, bf16, PASS_FORWARD, &p);
    if (status != SHERF_OK) return status;
    status = SHERF_NO_MEMORY;
    void *x = activation(call, p, call->in[0]);
    void *w = x ? packed_weights(call, p, call->in[1]) : NULL;
    if (w)
        status = plan_run(call, p->main, p->scratch, 3,
                          (plan_arg[]){{DNNL_ARG_SRC, p->x, x},
                                       {DNNL_ARG_WEIGHTS, p->w, w},
                                       {DNNL_ARG_DST, p->y, call->out[0]->data}});
    plan_release(p);
    return status;
}

/* dx += gain * (dy over w transposed) */
sherf_status dnnl_conv_data(op_call *call, bool transpose, bool bf16) {
    plan *p;
    sherf_status status = plan_for(call, transpose, bf16, PASS_DATA, &p);
    if (status != SHERF_OK) return status;
    status = SHERF_NO_MEMORY;
    const int64_t n = tensor_count(call->in[0]);
    void *dy = activation(call, p, call->dout[0]);
    void *w = dy ? packed_weights(call, p, call->in[1]) : NULL;
    float *dx = w ? arena_alloc(call->c, call->scratch, (size_t)n, sizeof *dx) : NULL;
    if (dx)
        status = plan_run(call, p->main, p->scratch, 3,
                          (plan_arg[]){{DNNL_ARG_DIFF_SRC, p->x, dx},
                                       {DNNL_ARG_WEIGHTS, p->w, w},
                                       {DNNL_ARG_DIFF_DST, p->y, dy}});
    if (status == SHERF_OK) cpu_add_scaled(call->c, n, p->key.gain, dx, call->fresh[0], call->din[0]->data);
    plan_release(p);
    return status;
}

/* dw += gain * (x correlated with dy) */
sherf_status dnnl_conv_weights(op_call *call, bool transpose, bool bf16) {
    plan *p;
    sherf_status status = plan_for(call, transpose, bf16, PASS_WEIGHTS, &p);
    if (status != SHERF_OK) return status;
    status = SHERF_NO_MEMORY;
    void *x = activation(call, p, call->in[0]);
    void *dy = x ? activation(call, p, call->dout[0]) : NULL;
    void *dw = dy ? arena_alloc(call->c, call->scratch, dnnl_memory_desc_get_size(p->w), 1) : NULL;
    if (dw)
        status = plan_run(call, p->main, p->scratch, 3,
                          (plan_arg[]){{DNNL_ARG_SRC, p->x, x},
                                       {DNNL_ARG_DIFF_WEIGHTS, p->w, dw},
                                       {DNNL_ARG_DIFF_DST, p->y, dy}});
    if (status == SHERF_OK)
        status =
            plan_run(call, p->weights, p->weights_scratch, 2,
                     (plan_arg[]){{DNNL_ARG_FROM, p->w, dw}, {DNNL_ARG_TO, &p->w_plain, call->din[1]->data}});
    plan_release(p);
    return status;
}
