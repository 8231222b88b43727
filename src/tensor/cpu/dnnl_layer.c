/* Convolutions for inference through oneDNN: pictures stay channels-last, and weights [k, k, in, out] are
 * reordered once into the primitive's own form. */
#include <string.h>

#include "base/only_read.h"
#include "tensor/cpu/dnnl_layer.h"
#include "tensor/cpu/dnnl_plan.h"

#define TRY(call)                                                                                            \
    do {                                                                                                     \
        dnnl_status_t status_ = (call);                                                                      \
        if (status_ != dnnl_success) return status_;                                                         \
    } while (0)

struct layer {
    dnnl_primitive_desc_t desc;
    dnnl_primitive_t primitive;
    const dnnl_memory_desc_t *x, *w, *y, *scratch; /* owned by desc */
    dnnl_memory_desc_t w_plain, b;
    void *weight; /* packed */
    float *bias;
    int threads;
};

void layer_free(layer *l) {
    if (!l) return;
    if (l->primitive) dnnl_primitive_destroy(l->primitive);
    if (l->desc) dnnl_primitive_desc_destroy(l->desc);
    mem_free(l->weight);
    mem_free(l->bias);
    mem_free(l);
}

size_t layer_scratch_bytes(const layer *l) {
    return dnnl_memory_desc_get_size(l->scratch);
}

/* The sum is applied before the activation. */
static dnnl_status_t post_ops(const layer_shape *s, dnnl_post_ops_t ops) {
    if (s->adds) TRY(dnnl_post_ops_append_sum(ops, 1));
    if (s->then == LAYER_RELU) return dnnl_post_ops_append_eltwise(ops, 1, dnnl_eltwise_relu, 0, 0);
    if (s->then == LAYER_RELU6) return dnnl_post_ops_append_eltwise(ops, 1, dnnl_eltwise_clip, 0, 6);
    return dnnl_success;
}

static dnnl_status_t attributes(const layer_shape *s, dnnl_primitive_attr_t attr) {
    dnnl_post_ops_t ops;
    TRY(dnnl_primitive_attr_set_scratchpad_mode(attr, dnnl_scratchpad_mode_user));
    TRY(dnnl_post_ops_create(&ops));
    dnnl_status_t status = post_ops(s, ops);
    if (status == dnnl_success) status = dnnl_primitive_attr_set_post_ops(attr, ops);
    dnnl_post_ops_destroy(ops);
    return status;
}

static int out_size(const layer_shape *s, int k) {
    return (s->size[k] + s->before[k] + s->after[k] - s->kernel[k]) / s->stride[k] + 1;
}

static dnnl_status_t describe(layer *l, const layer_shape *s, dnnl_primitive_attr_t attr,
                              dnnl_engine_t engine, bool biased) {
    const dnnl_dims_t x = {1, s->in, s->size[0], s->size[1]}, y = {1, s->out, out_size(s, 0), out_size(s, 1)},
                      b = {s->out}, stride = {s->stride[0], s->stride[1]},
                      before = {s->before[0], s->before[1]}, after = {s->after[0], s->after[1]};
    const dnnl_dims_t w = {s->out, s->in, s->kernel[0], s->kernel[1]},
                      w_depthwise = {s->out, 1, 1, s->kernel[0], s->kernel[1]};
    const int rank = s->depthwise ? 5 : 4;
    dnnl_memory_desc_t x_desc, w_desc, y_desc;
    dnnl_convolution_desc_t d;
    TRY(dnnl_memory_desc_init_by_tag(&x_desc, 4, x, dnnl_f32, dnnl_nhwc));
    TRY(dnnl_memory_desc_init_by_tag(&y_desc, 4, y, dnnl_f32, dnnl_nhwc));
    TRY(dnnl_memory_desc_init_by_tag(&l->b, 1, b, dnnl_f32, dnnl_a));
    TRY(dnnl_memory_desc_init_by_tag(&w_desc, rank, s->depthwise ? w_depthwise : w, dnnl_f32,
                                     dnnl_format_tag_any));
    TRY(dnnl_memory_desc_init_by_tag(&l->w_plain, rank, s->depthwise ? w_depthwise : w, dnnl_f32,
                                     s->depthwise ? dnnl_hwigo : dnnl_hwio));
    TRY(dnnl_convolution_forward_desc_init(&d, dnnl_forward_inference, dnnl_convolution_direct, &x_desc,
                                           &w_desc, biased ? &l->b : NULL, &y_desc, stride, before, after));
    TRY(dnnl_primitive_desc_create(&l->desc, &d, attr, engine, NULL));
    l->x = dnnl_primitive_desc_query_md(l->desc, dnnl_query_src_md, 0);
    l->w = dnnl_primitive_desc_query_md(l->desc, dnnl_query_weights_md, 0);
    l->y = dnnl_primitive_desc_query_md(l->desc, dnnl_query_dst_md, 0);
    l->scratch = dnnl_primitive_desc_query_md(l->desc, dnnl_query_scratchpad_md, 0);
    return dnnl_primitive_create(&l->primitive, l->desc);
}

static dnnl_status_t build(layer *l, const layer_shape *s, dnnl_engine_t engine, bool biased) {
    dnnl_primitive_attr_t attr;
    TRY(dnnl_primitive_attr_create(&attr));
    dnnl_status_t status = attributes(s, attr);
    if (status == dnnl_success) status = describe(l, s, attr, engine, biased);
    dnnl_primitive_attr_destroy(attr);
    return status;
}

static dnnl_status_t pack(layer *l, dnnl_engine_t engine, const float *weight) {
    dnnl_primitive_desc_t desc = NULL;
    dnnl_primitive_t reorder = NULL;
    const plan_arg args[] = {{DNNL_ARG_FROM, &l->w_plain, only_read(weight)}, {DNNL_ARG_TO, l->w, l->weight}};
    TRY(dnnl_reorder_primitive_desc_create(&desc, &l->w_plain, engine, l->w, engine, NULL));
    dnnl_status_t status = dnnl_primitive_create(&reorder, desc);
    if (status == dnnl_success) status = plan_execute(reorder, engine, 2, args);
    if (reorder) dnnl_primitive_destroy(reorder);
    dnnl_primitive_desc_destroy(desc);
    return status;
}

sherf_status layer_create(context *c, const layer_shape *shape, const float *weight, const float *bias,
                          layer **out) {
    sherf_status status = SHERF_NO_MEMORY;
    dnnl_engine_t engine = plan_engine();
    *out = NULL;
    if (!engine) return failure(c, SHERF_NO_MEMORY, "oneDNN: no engine");
    layer *l = mem_zero(c, 1, sizeof *l);
    if (!l) return status;
    if (!dnnl_room()) {
        mem_free(l);
        return failure(c, SHERF_NO_MEMORY, "out of memory: a convolution's plan");
    }
    l->threads = c->threads;
    const int threads = threads_set(l->threads);
    dnnl_status_t built = build(l, shape, engine, bias != NULL);
    if (built == dnnl_success) {
        l->weight = mem_alloc(c, dnnl_memory_desc_get_size(l->w), 1);
        l->bias = bias ? mem_alloc(c, (size_t)shape->out, sizeof *bias) : NULL;
        if (!l->weight || (bias && !l->bias)) goto done;
        if (bias) memcpy(l->bias, bias, (size_t)shape->out * sizeof *bias);
        built = pack(l, engine, weight);
    }
    if (built == dnnl_unimplemented)
        status =
            failure(c, SHERF_UNSUPPORTED, "oneDNN has no %sconvolution of %d x %d x %d to %d, kernel %d x %d",
                    shape->depthwise ? "depthwise " : "", shape->size[0], shape->size[1], shape->in,
                    shape->out, shape->kernel[0], shape->kernel[1]);
    else if (built != dnnl_success)
        status = failure(c, SHERF_NO_MEMORY, "oneDNN: status %d while making a convolution", (int)built);
    else
        status = SHERF_OK;
done:
    threads_set(threads);
    if (status == SHERF_OK)
        *out = l;
    else
        layer_free(l);
    return status;
}

sherf_status layer_run(context *c, const layer *l, const float *x, float *y, void *scratch) {
    plan_arg args[5] = {
        {DNNL_ARG_SRC, l->x, only_read(x)}, {DNNL_ARG_WEIGHTS, l->w, l->weight}, {DNNL_ARG_DST, l->y, y}};
    int count = 3;
    if (l->bias) args[count++] = (plan_arg){DNNL_ARG_BIAS, &l->b, l->bias};
    if (layer_scratch_bytes(l)) args[count++] = (plan_arg){DNNL_ARG_SCRATCHPAD, l->scratch, scratch};
    const int threads = threads_set(l->threads);
    const dnnl_status_t status = plan_execute(l->primitive, plan_engine(), count, args);
    threads_set(threads);
    if (status == dnnl_success) return SHERF_OK;
    return failure(c, SHERF_NO_MEMORY, "oneDNN: status %d in a convolution", (int)status);
}
