/* Shared by the tests of the fused radiance field in training: a small model, a bank of made-up numbers, one
 * forward and backward pass, and the difference of its gradients from another pass's. SIDE: of the pictures.
 * WITHOUT: of every three pixels, the number without a gradient. */
#ifndef POINTS_FUSED_PASS_H
#define POINTS_FUSED_PASS_H

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "synth/tube/tubeman.h"
#include "model/sherf/sherf.h"
#include "support.h"

/* The input of both paths: a small model, the tube person in two poses, a bank of made-up numbers. */
typedef struct {
    context *c;
    body_model *body;
    model *m;
    sherf_image image;
    observation_geometry *g;
    target_geometry *target;
    float *values; /* the numbers of the bank */
} scene;

enum { BANK = 3 + 1 + POINT_LEVELS };

static void look(const body_model *body, float azimuth, sherf_camera *out) {
    sherf_pose pose;
    sherf_pose_identity(&pose);
    sherf_camera_orbit((float[]){0, 0.1f, 0}, 3, azimuth, 0, 0.7f, SIDE, SIDE, out);
    (void)body;
}

/* The same weights every time, in the given memory. */
static model *weights_in(context *c, const model_config *config, const tensor_memory *memory) {
    model *m;
    assert_ok(c, model_create(c, config, 3, &m));
    /* biases and norms differ from 0 and 1, densities both show and hide */
    for (int i = 0; i < m->weights->count; i++) {
        parameter *q = m->weights->item[i];
        if (q->buffer || q->value.rank > 1 || !model_is_queried(config->kind, q->name)) continue;
        int64_t n = tensor_count(&q->value);
        for (int64_t k = 0; k < n; k++)
            tensor_f32(&q->value)[k] += 0.2f * (float)random_normal(random_key(7, q->name, 0), (uint64_t)k);
    }
    if (memory) assert_ok(c, parameters_place(c, m->weights, memory));
    assert_ok(c, parameters_make_grads(c, m->weights));
    return m;
}

static inline void scene_open(scene *s, const char *config_text) {
    context *c = s->c = test_context();
    model_config config;
    assert_ok(c, model_config_parse(c, config_text, &config));
    s->m = weights_in(c, &config, NULL);
    assert_ok(c, tubeman_create(c, &s->body));
    sherf_pose seen, shown;
    sherf_pose_identity(&seen);
    sherf_pose_identity(&shown);
    seen.poses_rad[3 * 16 + 2] = -0.9f;
    shown.poses_rad[3 * 17 + 2] = 0.7f;
    sherf_camera camera;
    look(s->body, 0.3f, &camera);
    s->image = (sherf_image){SIDE, SIDE, 3, mem_alloc(c, SIDE * SIDE * 3, sizeof(float))};
    for (int i = 0; i < SIDE * SIDE * 3; i++) s->image.data[i] = (float)random_uniform(11, (uint64_t)i);
    assert_ok(c, observation_geometry_create(c, &config, s->body, &s->image, &camera, &seen, true, &s->g));
    look(s->body, 1.1f, &camera);
    assert_ok(c, target_geometry_create(c, &config, s->body, &camera, &shown, s->g, false, &s->target));
}

static inline void scene_close(scene *s) {
    target_geometry_free(s->target);
    observation_geometry_free(s->g);
    mem_free(s->image.data);
    sherf_body_free(s->body);
    model_free(s->m);
    sherf_context_free(s->c);
}

/* One pass. Returns the outputs' fixed weighted sum, and all gradients in `out` (first the weights', then the
 * bank's). */
static inline int64_t pass(scene *s, model *m, const backend *with, bool bf16, float *frame_out,
                           float **gradients) {
    context *c = s->c;
    tape *t = tape_create(c, (tape_options){with, true, true, bf16});
    assert_non_null(t);
    const sherf_settings *k = model_sherf_settings(&m->config);
    sherf_bank own = {0};
    model_bank bank = {.count = BANK_LEVEL + POINT_LEVELS, .own = &own};
    int64_t R = k->plane_resolution, half = SIDE / 2, total = m->weights->trained_floats;
    tensor *leaf[BANK];
    for (int i = 0; i < BANK; i++) {
        int64_t dim[3] = {R, R, k->token_width};
        int rank = 3;
        if (i == 3) dim[0] = dim[1] = half, dim[2] = k->feature_width;
        if (i > 3)
            rank = 2, dim[0] = model_sherf_geometry(s->g)->level[i - 3].voxels,
            dim[1] = k->volume_channels[i - 4];
        leaf[i] = tape_tensor(t, T_F32, rank, dim);
        assert_non_null(leaf[i]);
        leaf[i]->needs_grad = true;
        float *values = mem_alloc(c, (size_t)tensor_count(leaf[i]), sizeof *values);
        for (int64_t n = 0; n < tensor_count(leaf[i]); n++)
            values[n] = (float)random_normal((uint64_t)i + 20, (uint64_t)n);
        assert_ok(c, tensor_upload(c, leaf[i], values));
        mem_free(values);
        total += tensor_count(leaf[i]);
    }
    for (int i = 0; i < 3; i++) {
        bank.tensor[BANK_PLANE + i] = leaf[i];
        bank.tensor[BANK_LEVEL + i] = leaf[4 + i];
    }
    bank.tensor[BANK_FEATURES] = leaf[3];
    bank.tensor[BANK_IMAGE] = tape_input(t, s->image.data, 3, (int64_t[]){SIDE, SIDE, 3});
    parameters_zero_grads(m->weights);
    tensor *frame = NULL;
    assert_ok(c, model_frame(t, m, s->body, s->g, &bank, s->target, 0, 5, &frame));
    assert_ok(c, tensor_download(c, frame, frame_out));
    float *d = mem_alloc(c, SIDE * SIDE * 5, sizeof *d);
    for (int64_t i = 0; i < SIDE * SIDE * 5; i++) /* no gradient for depth */
        d[i] = i % 5 == 4 || i % 15 < 5 * WITHOUT ? 0 : 1 + 0.5f * (float)random_normal(99, (uint64_t)i);
    assert_ok(c, tensor_upload(c, tape_grad(t, frame), d));
    mem_free(d);
    assert_ok(c, tape_backward_seeded(t));
    float *g = *gradients = mem_zero(c, (size_t)total, sizeof *g);
    const parameters *p = m->weights;
    const tensor whole = {
        .type = T_F32, .rank = 1, .dim = {p->trained_floats}, .data = p->grads, .memory = p->memory};
    assert_ok(c, tensor_download(c, &whole, g));
    g += p->trained_floats;
    for (int i = 0; i < BANK; i++) {
        assert_non_null(leaf[i]->grad);
        assert_ok(c, tensor_download(c, leaf[i]->grad, g));
        g += tensor_count(leaf[i]);
    }
    tape_free(t);
    return total;
}

/* ---- ops in bf16 on any processor: products of rounded factors with float32 sums. In a pass only linear has
 * products in bf16. ---- */
static sherf_status rounded(op_call *call, const tensor *x, tensor *out) {
    const int64_t n = tensor_count(x);
    const float *from = x->data;
    uint32_t *to = arena_alloc(call->c, call->scratch, (size_t)n, sizeof *to);
    if (!to) return SHERF_NO_MEMORY;
    memcpy(to, from, (size_t)n * sizeof *to);
    for (int64_t i = 0; i < n; i++) /* to nearest even; all numbers of a pass are finite */
        to[i] = (to[i] + 0x7fff + (to[i] >> 16 & 1)) & 0xffff0000u;
    *out = *x;
    out->data = to;
    return SHERF_OK;
}

/* Like the processor's own op: few rows, inputs or outputs stay in float32. */
static bool is_rounded(const op_call *call) {
    const int64_t I = call->in[1]->dim[1], O = call->in[1]->dim[0];
    return I >= 16 && O >= 16 && tensor_count(call->in[0]) / I >= 16;
}

static sherf_status linear_rounded(op_call *call) {
    op_call k = *call;
    tensor x, w;
    if (!is_rounded(call)) return backend_cpu.forward[OP_linear](call);
    sherf_status status = rounded(call, call->in[0], &x);
    if (!status) status = rounded(call, call->in[1], &w);
    k.in[0] = &x;
    k.in[1] = &w;
    return status ? status : backend_cpu.forward[OP_linear](&k);
}

static sherf_status linear_rounded_backward(op_call *call) {
    op_call k = *call, bias = *call;
    tensor x, w, dy;
    if (!is_rounded(call)) return backend_cpu.backward[OP_linear](call);
    bias.din[0] = bias.din[1] = k.din[2] = NULL; /* the bias's gradient is a sum, not a product */
    sherf_status status = backend_cpu.backward[OP_linear](&bias);
    if (!status) status = rounded(call, call->in[0], &x);
    if (!status) status = rounded(call, call->in[1], &w);
    if (!status) status = rounded(call, call->dout[0], &dy);
    k.in[0] = &x;
    k.in[1] = &w;
    k.dout[0] = &dy;
    return status ? status : backend_cpu.backward[OP_linear](&k);
}

static inline void ops_round(backend *b) {
    b->forward[OP_linear] = linear_rounded;
    b->backward[OP_linear] = linear_rounded_backward;
}

/* |a - b| / |b| */
static double off(const float *a, const float *b, int64_t n) {
    double apart = 0, size = 0;
    for (int64_t i = 0; i < n; i++) {
        apart += (double)(a[i] - b[i]) * (a[i] - b[i]);
        size += (double)b[i] * b[i];
    }
    assert_true(size > 0);
    return sqrt(apart / size);
}

/* Rounding to bf16 in a different order may differ from float32 about as much as the ops' bf16 does, but not
 * much more. */
static void no_worse(const char *name, const float *fused, const float *rounded, const float *exact,
                     int64_t n) {
    const double a = off(fused, exact, n), b = off(rounded, exact, n);
    if (getenv("SHERF_TEST_VERBOSE")) printf("%-56s %.4f, ops in bf16 %.4f\n", name, a, b);
    if (a > 1.3 * b + 0.003) fail_msg("%s: %g from float32, the ops in bf16 %g", name, a, b);
}

/* Checks the gradients of everything that enters a point. */
static inline void no_worse_all(const scene *s, const float *fused, const float *rounded, const float *exact,
                                int64_t n) {
    const parameters *p = s->m->weights;
    int checked = 0;
    for (int i = 0; i < p->count; i++) {
        const parameter *q = p->item[i];
        if (q->buffer || !model_is_queried(s->m->config.kind, q->name)) continue;
        no_worse(q->name, fused + q->offset, rounded + q->offset, exact + q->offset, tensor_count(&q->value));
        checked++;
    }
    assert_int_equal(checked, 23 + 2 * model_sherf_settings(&s->m->config)->decoder_depth);
    no_worse("bank", fused + p->trained_floats, rounded + p->trained_floats, exact + p->trained_floats,
             n - p->trained_floats);
}

#endif
