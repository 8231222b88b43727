/* Tests of a whole training step on a GPU, or on the emulated CUDA backend (tests/support/cuda): encoder,
 * frame, losses and every gradient, against the CPU's in float32. The device's memory is locked between ops,
 * so host code that accesses a tensor's data there ends the program. */
#include "losses_of.h"
#include "support.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#ifdef HAVE_CUDA_EMULATED
#include "base/device.h"
#include "synth/tube/tubeman.h"
#include "model/sherf/sherf.h"

extern const backend backend_emulated;

enum { SIDE = 48 };

typedef struct {
    context *c;
    body_model *body;
    model_config config;
    sherf_image image;
    observation_geometry *g;
    target_geometry *target;
} scene;

static void scene_open(scene *s) {
    context *c = s->c = test_context();
    sherf_pose seen, shown;
    sherf_camera camera;
    assert_ok(c,
              model_config_parse(c,
                                 "small,plane_resolution=16,channel_max=16,encoder_width=8,style_width=16,"
                                 "volume_channels0=8,volume_channels1=8,volume_channels2=16,decoder_width=32,"
                                 "decoder_depth=3,decoder_skip=1,view_width=16,samples=12,voxel_size_m=0.03",
                                 &s->config));
    assert_ok(c, tubeman_create(c, &s->body));
    sherf_pose_identity(&seen);
    sherf_pose_identity(&shown);
    seen.poses_rad[3 * 16 + 2] = -0.9f;
    shown.poses_rad[3 * 17 + 2] = 0.7f;
    s->image = (sherf_image){SIDE, SIDE, 3, mem_alloc(c, SIDE * SIDE * 3, sizeof(float))};
    for (int i = 0; i < SIDE * SIDE * 3; i++) s->image.data[i] = (float)random_uniform(11, (uint64_t)i);
    sherf_camera_orbit((float[]){0, 0.1f, 0}, 3, 0.3f, 0, 0.7f, SIDE, SIDE, &camera);
    assert_ok(c, observation_geometry_create(c, &s->config, s->body, &s->image, &camera, &seen, true, &s->g));
    sherf_camera_orbit((float[]){0, 0.1f, 0}, 3, 1.1f, 0, 0.7f, SIDE, SIDE, &camera);
    assert_ok(c, target_geometry_create(c, &s->config, s->body, &camera, &shown, s->g, false, &s->target));
}

static void scene_close(scene *s) {
    target_geometry_free(s->target);
    observation_geometry_free(s->g);
    mem_free(s->image.data);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
}

typedef struct {
    model *m; /* for names and offsets */
    float frame[SIDE * SIDE * 5];
    loss_values losses;
    float *values, *grads; /* running statistics are among the values */
} result;

static float *block_read(context *c, const parameters *p, float *block, int64_t floats) {
    float *out = mem_alloc(c, (size_t)floats, sizeof *out);
    assert_non_null(out);
    tensor whole = {.type = T_F32, .rank = 1, .dim = {floats}, .data = block, .memory = p->memory};
    assert_ok(c, tensor_download(c, &whole, out));
    return out;
}

static void step(scene *s, const backend *b, result *out) {
    context *c = s->c;
    assert_ok(c, model_create(c, &s->config, 3, &out->m));
    parameters *p = out->m->weights;
    if (b->memory) assert_ok(c, parameters_place(c, p, b->memory));
    assert_ok(c, parameters_make_grads(c, p));
    tape *t = tape_create(c, (tape_options){b, true, true, false});
    assert_non_null(t);
    unsigned char *mask = mem_alloc(c, SIDE * SIDE, 1);
    for (int i = 0; i < SIDE * SIDE; i++) mask[i] = i % 3 == 0;
    const loss_target truth = {.width = SIDE,
                               .height = SIDE,
                               .image = s->image.data,
                               .mask = mask,
                               .at_box = s->target->rays->at_box};
    model_bank bank;
    tensor *frame, *total;
    for (int round = 0; round < 2; round++) { /* the second round runs in used memory */
        tape_reset(t);
        parameters_zero_grads(p);
        assert_ok(c, model_encode(t, out->m, s->body, s->g, &bank));
        assert_ok(c, model_frame(t, out->m, s->body, s->g, &bank, s->target, 0, 5, &frame));
        assert_ok(c, losses_of(t, NULL, frame, &truth, &total, &out->losses));
        assert_non_null(total);
        assert_ok(c, tensor_download(c, frame, out->frame));
        assert_ok(c, tape_backward(t, total, 1));
    }
    out->values = block_read(c, p, p->values, p->total_floats);
    out->grads = block_read(c, p, p->grads, p->trained_floats);
    mem_free(mask);
    tape_free(t);
}

/* |a - b| / |b| */
static double off(const float *a, const float *b, int64_t n) {
    double apart = 0, size = 0;
    for (int64_t i = 0; i < n; i++) {
        apart += (double)(a[i] - b[i]) * (a[i] - b[i]);
        size += (double)b[i] * b[i];
    }
    return apart > 0 ? sqrt(apart / size) : 0;
}

static void no_further(const char *name, double is, double bound) {
    if (getenv("SHERF_TEST_VERBOSE")) printf("%-56s %.2e\n", name, is);
    if (!(is <= bound)) fail_msg("%s: %g from the CPU's, %g is allowed", name, is, bound);
}

static void step_agrees(void **state) {
    scene s = {0};
    static result want, got;
    scene_open(&s);
    step(&s, &backend_cpu, &want);
    step(&s, backend_of(&(context){.device = SHERF_DEVICE_CUDA}), &got);
    no_further("frame", off(got.frame, want.frame, SIDE * SIDE * 5), 1e-4);
    no_further("loss", fabs(got.losses.total - want.losses.total) / fabs(want.losses.total), 1e-4);
    const parameters *p = want.m->weights;
    for (int i = 0; i < p->count; i++) {
        const parameter *q = p->item[i];
        const int64_t n = tensor_count(&q->value);
        if (q->buffer)
            no_further(q->name, off(got.values + q->offset, want.values + q->offset, n), 1e-4);
        else
            no_further(q->name, off(got.grads + q->offset, want.grads + q->offset, n), 1e-3);
    }
    for (int k = 0; k < 2; k++) {
        result *r = k ? &got : &want;
        model_free(r->m);
        mem_free(r->values);
        mem_free(r->grads);
    }
    scene_close(&s);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    char line[160];
    const bool gpu = device_gpu_present(line, sizeof line);
    if (!gpu) backend_stand_in(&backend_emulated);
    printf("%s: %s\n", gpu ? "on a GPU" : "on no GPU", line);
    const struct CMUnitTest tests[] = {cmocka_unit_test(step_agrees)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
#else
int main(void) {
    puts("skipped: there was no C++ compiler for the emulated kernels");
    return 77;
}
#endif
