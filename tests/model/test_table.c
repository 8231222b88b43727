/* Tests of the table of models: a second model, known only to this file, is trained, saved, loaded and
 * rendered by the same code as SHERF. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/data.h"
#include "io/safetensors.h"
#include "avatar/avatar.h"
#include "tube_training.h"

/* ---- the model: one convolution of the picture, read where a point is seen, and one linear layer ---- */
typedef struct {
    int width;
    float density; /* initial density */
} plain_settings;

typedef struct {
    tensor *conv;
    linear_layer out;
} plain_network;

static const model_preset presets[] = {{"eight", ""}, {"twelve", "width=12"}, {0}};
static const model_setting settings[] = {{"width", MODEL_SETTING_AT(plain_settings, width), 4, 64, 4},
                                         {"density", MODEL_SETTING_AT(plain_settings, density), 0, 100, 0},
                                         {0}};

static const plain_settings *settings_of(const model_config *config) {
    return (const plain_settings *)config->own.bytes;
}

static void defaults(model_config *out) {
    const plain_settings own = {.width = 8, .density = 2.5f};
    memcpy(out->own.bytes, &own, sizeof own);
    out->samples = 16;
}

static void plain_declare(declaration *d, const model_config *config, void *network) {
    plain_network *n = network;
    const plain_settings *k = settings_of(config);
    n->conv = declare_weights(d, true, DIMS(k->width, 3, 3, 3), "conv");
    n->out.w = declare_weights(d, false, DIMS(4, k->width), "out");
    n->out.b = declare(d, (first_values){.constant = k->density}, DIMS(4), "out.bias");
}

static sherf_status encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank) {
    const plain_network *n = m->network;
    tensor *image = tape_input(t, g->image, 3, (int64_t[]){g->height, g->width, 3});
    bank->tensor[bank->count++] = op_relu(t, op_conv2d(t, image, n->conv, 1, 1, 1));
    return tape_status(t);
}

static sherf_status query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb) {
    const plain_network *n = m->network;
    tensor *at = tape_input(t, points->observed_px + 2 * begin, 2, (int64_t[]){end - begin, 2});
    tensor *y = linear_forward(t, &n->out, op_sample_bilinear(t, bank->tensor[0], at));
    *sigma = op_slice(t, y, 0, 1);
    *rgb = op_sigmoid(t, op_slice(t, y, 1, 3), 1, 0);
    return tape_status(t);
}

static void kept(const model_config *config, kept_bank *out) {
    *out = (kept_bank){1, {{"map", T_F32, 3, {0, 0, settings_of(config)->width}}}};
}

static const model_kind plain = {.name = "plain",
                                 .presets = presets,
                                 .settings = settings,
                                 .defaults = defaults,
                                 .network_bytes = sizeof(plain_network),
                                 .declare = plain_declare,
                                 .queried = (const char *const[]){"out", NULL},
                                 .encode = encode,
                                 .query = query,
                                 .kept = kept};

/* ---- tests ---- */
static int make_data(void **state) {
    context *c = test_context();
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 3, .size_px = 32, .seed = 5};
    const sherf_status status = tubes_make(c, &synth);
    sherf_context_free(c);
    model_kind_add(&plain);
    return status != SHERF_OK;
}

static void settings_are_the_models_own(void **state) {
    context *c = test_context();
    model_config k;
    assert_ok(c, model_config_parse(c, "small,samples=20", &k));
    assert_string_equal(k.kind->name, "sherf");
    assert_ok(c, model_config_parse(c, "sherf:small", &k));
    assert_ok(c, model_config_parse(c, "plain:twelve,samples=20,density=0.75", &k));
    assert_ptr_equal(k.kind, &plain);
    assert_int_equal(settings_of(&k)->width, 12);
    char *text = model_config_text(c, &k);
    assert_string_equal(text, "twelve,density=0.75,samples=20");
    mem_free(text);
    assert_fails(c, model_config_parse(c, "plain:small", &k), SHERF_BAD_ARGUMENT,
                 "model preset 'small': should be eight or twelve");
    assert_fails(c, model_config_parse(c, "plain:eight,heads=2", &k), SHERF_BAD_ARGUMENT, "no such setting");
    assert_fails(c, model_config_parse(c, "plain:eight,width=5", &k), SHERF_BAD_ARGUMENT, "in steps of 4");
    assert_fails(c, model_config_parse(c, "plain:eight,density=101", &k), SHERF_BAD_ARGUMENT,
                 "must be 0 to 100");
    assert_fails(c, model_config_parse(c, "nhp:own,occlusion=1", &k), SHERF_BAD_ARGUMENT,
                 "model nhp has no such way");
    assert_ok(c, model_config_parse(c, "mps-nerf:own,occlusion=1", &k));
    assert_fails(c, model_config_parse(c, "other:eight", &k), SHERF_UNSUPPORTED, "model 'other'");
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static sherf_train_options training(int64_t steps, const char *preset) {
    sherf_train_options o = tube_training(preset, path_of("run"), steps);
    o.people = "0-0", o.batch = 1, o.targets = 1, o.seed = 3, o.background = NULL;
    return o;
}

/* Renders an avatar, and renders it again from its file. */
static void check_avatar(context *c, const sherf_model *m, const sherf_body *body) {
    char picture[600];
    sherf_observation *o;
    sherf_avatar *a;
    sherf_frame frame[3] = {0};
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF}, usual = {0};
    snprintf(picture, sizeof picture, "thuman:%s#tube_000/0/0", root);
    assert_ok(c, sherf_observation_load(c, picture, &o));
    assert_ok(c, sherf_avatar_create(c, m, body, o, &a));
    const sherf_pose *pose = sherf_observation_pose(o);
    const sherf_camera *camera = sherf_observation_camera(o);
    assert_ok(c, sherf_render(c, a, body, pose, camera, &exact, &frame[0]));
    assert_ok(c, sherf_render(c, a, body, pose, camera, &usual, &frame[1])); /* empty space, detail, haze */
    assert_ok(c, sherf_avatar_save(c, a, path_of("avatar.safetensors")));
    sherf_avatar_free(a);
    assert_ok(c, sherf_avatar_load(c, path_of("avatar.safetensors"), body, &a));
    assert_ok(c, sherf_render(c, a, body, pose, camera, &exact, &frame[2]));
    double sum = 0;
    const size_t n = (size_t)camera->width_px * (size_t)camera->height_px;
    for (size_t i = 0; i < n; i++) sum += (double)frame[0].opacity.data[i];
    assert_true(frame[0].points > 100 && sum > (double)n / 50 && frame[1].points > 0);
    assert_memory_equal(frame[0].color.data, frame[2].color.data, 3 * n * sizeof(float));
    for (int i = 0; i < 3; i++) sherf_frame_free(&frame[i]);
    sherf_avatar_free(a);
    sherf_observation_free(o);
}

static void a_second_model_trains_and_renders(void **state) {
    context *c = test_context();
    sherf_model *m, *before;
    sherf_body *body;
    sherf_train_options o = training(4, "plain:eight");
    assert_ok(c, sherf_train(c, &o));
    o = training(8, "plain:eight"); /* continues from its checkpoint */
    assert_ok(c, sherf_train(c, &o));
    o = training(9, "small");
    assert_fails(c, sherf_train(c, &o), SHERF_MISMATCH, "leave the preset out");
    assert_non_null(strstr(c->message, "of preset plain:eight"));
    assert_non_null(strstr(c->message, ", not sherf:small: "));
    assert_ok(c, sherf_body_load(c, path_of("tubeman.safetensors"), &body));
    assert_ok(c, sherf_model_load(c, path_of("run/model.safetensors"), &m));
    assert_ptr_equal(m->config.kind, &plain);
    assert_true(m->config.px_per_m > 0 && m->config.image_size == 32);
    assert_ok(c, sherf_model_create(c, "plain:eight", 3, &before));
    assert_true(memcmp(before->weights->values, m->weights->values,
                       (size_t)m->weights->trained_floats * sizeof(float)) != 0);
    check_avatar(c, m, body);
    assert_fails(c, model_load_resnet(c, m, "none"), SHERF_MISMATCH, "model plain has no ResNet-18");
    sherf_model_free(before);
    sherf_model_free(m);
    sherf_body_free(body);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* At its points, a frame gives the values that the model's ops give. */
static void check_points(context *c, const sherf_model *m, const sherf_body *body) {
    char picture[600];
    sherf_observation *o;
    sherf_avatar *a;
    observation_geometry *g;
    target_geometry *target;
    model_bank bank;
    snprintf(picture, sizeof picture, "thuman:%s#tube_000/0/0", root);
    assert_ok(c, sherf_observation_load(c, picture, &o));
    assert_ok(c, sherf_avatar_create(c, m, body, o, &a));
    assert_ok(c,
              observation_geometry_create(c, &m->config, body, &o->image, &o->camera, &o->pose, false, &g));
    assert_ok(c, target_geometry_create(c, &m->config, body, &o->camera, &o->pose, g, false, &target));
    const int64_t P = target->points->count;
    float *rgb = mem_alloc(c, (size_t)P, 3 * sizeof *rgb), *sigma = mem_alloc(c, (size_t)P, sizeof *sigma);
    assert_ok(c, avatar_query(c, a, body, target->points, rgb, sigma));
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu});
    tensor *density = tape_tensor(t, T_F32, 2, (int64_t[]){P, 1}),
           *color = tape_tensor(t, T_F32, 2, (int64_t[]){P, 3});
    assert_ok(c, model_encode(t, m, body, g, &bank));
    assert_ok(c, model_query(t, m, body, g, &bank, target->points, density, color));
    float largest = 0;
    for (int64_t i = 0; i < P; i++) largest = fmaxf(largest, fabsf(tensor_f32(density)[i]));
    assert_true(P > 100 && largest > 0);
    for (int64_t i = 0; i < P; i++) assert_float_equal(tensor_f32(density)[i], sigma[i], 3e-4f * largest);
    for (int64_t i = 0; i < 3 * P; i++) assert_float_equal(tensor_f32(color)[i], rgb[i], 3e-4f);
    if (a->field_kind == &field_of_ops) { /* a file may state any size of its volume */
        a->kept.array[a->kept.count - 1].dim[0]--;
        assert_fails(c, avatar_query(c, a, body, target->points, rgb, sigma), SHERF_MISMATCH,
                     "of the volume has");
    }
    mem_free(rgb);
    mem_free(sigma);
    tape_free(t);
    target_geometry_free(target);
    observation_geometry_free(g);
    sherf_avatar_free(a);
    sherf_observation_free(o);
}

/* SHERF with fewer and more levels than its fused network supports, and with other encodings. */
static void sherfs_settings_reach_frames(void **state) {
    static const struct {
        const char *run, *preset, *kept;
    } variants[] = {{"one_level", TINY ",point_levels=1", "point_levels=1"},
                    {"four_levels", TINY ",volume_channels3=24,point_levels=4", "point_levels=4"},
                    {"encodings", TINY ",position_frequencies=4,direction_frequencies=2,color_frequencies=6",
                     "color_frequencies=6"}};
    context *c = test_context();
    sherf_body *body;
    assert_ok(c, sherf_body_load(c, path_of("tubeman.safetensors"), &body));
    for (size_t i = 0; i < COUNT_OF(variants); i++) {
        char weights[1100];
        sherf_model *m;
        sherf_train_options o = training(2, variants[i].preset);
        o.output = path_of(variants[i].run);
        snprintf(weights, sizeof weights, "%s/model.safetensors", o.output);
        assert_ok(c, sherf_train(c, &o));
        assert_ok(c, sherf_model_load(c, weights, &m));
        char *text = model_config_text(c, &m->config);
        assert_non_null(strstr(text, variants[i].kept));
        mem_free(text);
        check_points(c, m, body);
        check_avatar(c, m, body);
        sherf_model_free(m);
    }
    sherf_body_free(body);
    model_config k;
    assert_fails(c, model_config_parse(c, "small,point_levels=5", &k), SHERF_BAD_ARGUMENT, "must be 1 to 4");
    assert_fails(c, model_config_parse(c, "small,color_frequencies=4", &k), SHERF_BAD_ARGUMENT, "too few");
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* From settings to a frame, with memory running out at each allocation in turn. */
static void every_allocation_fails(void **state) {
    context *c = test_context();
    char picture[600];
    sherf_body *body;
    sherf_observation *o;
    snprintf(picture, sizeof picture, "thuman:%s#tube_000/0/0", root);
    assert_ok(c, sherf_body_load(c, path_of("tubeman.safetensors"), &body));
    assert_ok(c, sherf_observation_load(c, picture, &o));
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF, .samples = 4};
    const size_t live = mem_live();
    bool done = false;
    for (long k = 0; !done; k++) {
        sherf_model *m = NULL;
        sherf_avatar *a = NULL;
        sherf_frame frame = {0};
        mem_fail_after(k);
        sherf_status status = sherf_model_create(c, "plain:eight", 3, &m);
        if (!status) status = sherf_avatar_create(c, m, body, o, &a);
        if (!status)
            status = sherf_render(c, a, body, sherf_observation_pose(o), sherf_observation_camera(o), &exact,
                                  &frame);
        mem_fail_after(-1);
        done = !status;
        assert_true(done || status == SHERF_NO_MEMORY);
        sherf_frame_free(&frame);
        sherf_avatar_free(a);
        sherf_model_free(m);
        assert_int_equal(mem_live(), live);
        if (k > 3000) fail();
    }
    sherf_observation_free(o);
    sherf_body_free(body);
    sherf_context_free(c);
}

/* Weights of a model that this version does not have, and of no model at all. */
static void unknown_models_are_one_line(void **state) {
    context *c = test_context();
    const char *path = path_of("other.safetensors");
    const float one = 1;
    const safetensor_item item = {"w", T_F32, 1, {1}, &one};
    sherf_model *m;
    sherf_avatar *a;
    sherf_body *body;
    const safetensor_metadata other[] = {{"format", "sherf-model"}, {"model", "other"}};
    assert_ok(c, safetensors_write(c, path, 1, &item, 2, other));
    assert_fails(c, sherf_model_load(c, path, &m), SHERF_UNSUPPORTED,
                 "model 'other': this version of sherf has no such model");
    const safetensor_metadata without[] = {{"format", "sherf-model"}, {"model", "plain"}};
    assert_ok(c, safetensors_write(c, path, 1, &item, 2, without));
    assert_fails(c, sherf_model_load(c, path, &m), SHERF_BAD_FILE, "without its settings (plain.config)");
    /* an avatar of that model */
    assert_ok(c, sherf_body_load(c, path_of("tubeman.safetensors"), &body));
    char fingerprint[32];
    snprintf(fingerprint, sizeof fingerprint, "%016llx", (unsigned long long)body->fingerprint);
    const safetensor_metadata avatar[] = {
        {"format", "sherf-avatar"}, {"model", "other"}, {"body", fingerprint}};
    assert_ok(c, safetensors_write(c, path, 1, &item, 3, avatar));
    assert_fails(c, sherf_avatar_load(c, path, body, &a), SHERF_UNSUPPORTED, "model 'other'");
    sherf_body_free(body);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(settings_are_the_models_own), cmocka_unit_test(a_second_model_trains_and_renders),
        cmocka_unit_test(sherfs_settings_reach_frames), cmocka_unit_test(every_allocation_fails),
        cmocka_unit_test(unknown_models_are_one_line)};
    return cmocka_run_group_tests(tests, make_data, NULL);
}
