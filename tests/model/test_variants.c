/* Tests of SHERF without some of its features or its transformer: what the decoder reads, which weights are
 * declared, and use. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "model/sherf/sherf.h"
#include "rival.h"

#define TINY                                                                                                 \
    "small,encoder_width=8,style_width=16,plane_resolution=16,channel_base=256,channel_max=16,"              \
    "volume_channels0=8,volume_channels1=8,volume_channels2=8,decoder_width=16,decoder_depth=2,"             \
    "decoder_skip=0,view_width=16,voxel_size_m=0.05,samples=24"
enum { SIDE = 32, RAYS = 80, WIDTH = 32, PIXEL = 96 };

/* ---- tokens, in double, from the definition ---- */
typedef struct {
    const sherf_settings *k;
    rival_weights w;
    const float *plane[3], *pixel, *volume; /* of one point; NULL: off */
} second;

static void second_tokens(const second *s, double token[3][WIDTH]) {
    double volume[64], point[PIXEL], parts[3 * WIDTH];
    int channels = 0;
    for (int l = 0; l < s->k->point_levels; l++) channels += s->k->volume_channels[l];
    for (int i = 0; i < channels && s->volume; i++) volume[i] = (double)s->volume[i];
    if (s->volume) rival_linear(&s->w, "renderer.conv1d_projection", channels, volume, PIXEL, point);
    for (int t = 0; t < 3; t++) {
        int n = 0;
        for (int i = 0; i < WIDTH && s->plane[t]; i++) parts[n++] = (double)s->plane[t][i];
        for (int i = 0; i < WIDTH && s->pixel; i++) parts[n++] = (double)s->pixel[t * WIDTH + i];
        for (int i = 0; i < WIDTH && s->volume; i++) parts[n++] = point[t * WIDTH + i];
        if (n > WIDTH)
            rival_linear(&s->w, "renderer.conv1d_reprojection", n, parts, WIDTH, token[t]);
        else
            memcpy(token[t], parts, sizeof token[t]);
    }
}

/* (v - mean) / sqrt(variance + 1e-5) */
static void second_norm(int n, double *v) {
    double mean = 0, square = 0;
    for (int i = 0; i < n; i++) mean += v[i] / n;
    for (int i = 0; i < n; i++) square += (v[i] - mean) * (v[i] - mean) / n;
    for (int i = 0; i < n; i++) v[i] = (v[i] - mean) / sqrt(square + 1e-5);
}

/* gamma * norm(W_c [pixel, point]) + beta; gamma and beta are linear in the plane's values. */
static void second_adain(const second *s, const double *style, const double *content, double out[WIDTH]) {
    double scale[WIDTH], shift[WIDTH];
    rival_linear(&s->w, "renderer.adain.content", 2 * WIDTH, content, WIDTH, out);
    rival_linear(&s->w, "renderer.adain.scale", WIDTH, style, WIDTH, scale);
    rival_linear(&s->w, "renderer.adain.shift", WIDTH, style, WIDTH, shift);
    second_norm(WIDTH, out);
    for (int i = 0; i < WIDTH; i++) out[i] = scale[i] * out[i] + shift[i];
}

/* sin((15 f + 30) (W x + b) + phi) twice; f + 1 in the slow one. */
static void second_siren(const second *s, const double *style, const double *given, double out[WIDTH]) {
    const bool film = s->k->fusion == FUSION_FILM;
    double hidden[WIDTH], mapped[4 * WIDTH], content[2 * WIDTH];
    rival_linear(&s->w, "renderer.siren.style.0", WIDTH, style, WIDTH, hidden);
    for (int i = 0; i < WIDTH; i++) hidden[i] *= hidden[i] < 0 ? 0.2 : 1;
    rival_linear(&s->w, "renderer.siren.style.1", WIDTH, hidden, 4 * WIDTH, mapped);
    memcpy(content, given, sizeof content);
    second_norm(2 * WIDTH, content);
    for (int layer = 0; layer < 2; layer++) {
        const double *f = mapped + 2 * layer * WIDTH, *phase = f + WIDTH;
        if (layer)
            rival_linear(&s->w, "renderer.siren.sine.1", WIDTH, hidden, WIDTH, out);
        else
            rival_linear(&s->w, "renderer.siren.sine.0", 2 * WIDTH, content, WIDTH, out);
        for (int i = 0; i < WIDTH; i++)
            hidden[i] = sin((film ? f[i] + 1 : 15 * f[i] + 30) * out[i] + phase[i]);
    }
    memcpy(out, hidden, sizeof hidden);
}

static void second_styled(const second *s, double token[3][WIDTH]) {
    double volume[64], point[PIXEL], style[WIDTH], content[2 * WIDTH];
    int channels = 0;
    for (int l = 0; l < s->k->point_levels; l++) channels += s->k->volume_channels[l];
    for (int i = 0; i < channels; i++) volume[i] = (double)s->volume[i];
    rival_linear(&s->w, "renderer.conv1d_projection", channels, volume, PIXEL, point);
    for (int t = 0; t < 3; t++) {
        for (int i = 0; i < WIDTH; i++) {
            style[i] = (double)s->plane[t][i];
            content[i] = (double)s->pixel[t * WIDTH + i];
            content[WIDTH + i] = point[t * WIDTH + i];
        }
        (s->k->fusion == FUSION_ADAIN ? second_adain : second_siren)(s, style, content, token[t]);
    }
}

/* What the decoder reads of a point: 64 numbers, or the first 64 of 96. */
static void second_fused(const second *s, double out[2 * WIDTH]) {
    double token[3][WIDTH];
    (s->k->fusion >= FUSION_ADAIN ? second_styled : second_tokens)(s, token);
    if (s->k->fusion >= FUSION_FAIR)
        rival_linear(&s->w, "renderer.fair", 3 * WIDTH, token[0], 2 * WIDTH, out);
    else
        memcpy(out, token[0], 2 * WIDTH * sizeof *out);
}

static void every_weight_has_a_gradient(const char *preset, const model *m) {
    for (int i = 0; i < m->weights->count; i++) {
        const parameter *q = m->weights->item[i];
        /* a picture of 32 pixels is a single pixel in the global encoder's last stage, and batch norm of one
         * pixel is constant */
        bool any = q->buffer || !strncmp(q->name, "encoder_2d.", 11);
        for (int64_t k = 0; k < tensor_count(&q->value) && !any; k++)
            any = m->weights->grads[q->offset + k] != 0;
        if (!any) fail_msg("%s: %s has no gradient", preset, q->name);
    }
}

/* Each point's fused tokens agree with the definition, and every declared weight has an effect. */
static void agrees(const char *preset, double tolerance) {
    context *c = test_context();
    rival_scene scene;
    model_config config;
    model *m;
    model_bank bank;
    point_outputs out;
    tensor *frame;
    assert_ok(c, model_config_parse(c, preset, &config));
    rival_scene_open(c, &config, 1, RAYS, &scene);
    assert_ok(c, model_create(c, &config, 7, &m));
    rival_shake(m);
    tensor_f32(model_tensor(m, "decoder.alpha_linear.bias"))[0] += 8; /* some points are seen */
    assert_ok(c, parameters_make_grads(c, m->weights));
    second s = {.k = model_sherf_settings(&config)};
    rival_weights_take(m, &s.w);
    const point_set *points = scene.target->points;
    const int64_t n = points->count;
    assert_true(n > 20);
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true, .training = true});
    assert_ok(c, model_encode(t, m, scene.body, scene.geometry, &bank));
    assert_ok(c, model_sherf_points(t, m, scene.body, scene.geometry, &bank, points, 0, n, &out));
    tensor *pixel = s.k->use_pixel
                        ? pixel_sample(t, &model_sherf_network(m)->pixel, &bank, points->observed_px, n)
                        : NULL;
    const int64_t columns = tensor_columns(out.fusion);
    assert_int_equal(columns, s.k->fusion >= FUSION_FAIR ? 2 * WIDTH : 3 * WIDTH);
    double worst = 0, largest = 0;
    for (int64_t i = 0; i < n; i++) {
        double want[2 * WIDTH];
        for (int k = 0; k < 3; k++) s.plane[k] = out.plane[k] ? tensor_f32(out.plane[k]) + i * WIDTH : NULL;
        s.pixel = pixel ? tensor_f32(pixel) + i * PIXEL : NULL;
        s.volume = out.volume ? tensor_f32(out.volume) + i * tensor_columns(out.volume) : NULL;
        second_fused(&s, want);
        for (int k = 0; k < 2 * WIDTH; k++) {
            worst = fmax(worst, fabs(want[k] - (double)tensor_f32(out.fusion)[i * columns + k]));
            largest = fmax(largest, fabs(want[k]));
        }
    }
    if (!(largest > 0.01 && worst < tolerance * largest))
        fail_msg("%s: %g apart of %g", preset, worst, largest);
    assert_true(!out.plane[0] == !s.k->use_global && !out.volume == !s.k->use_point);
    tape_reset(t);
    assert_ok(c, model_encode(t, m, scene.body, scene.geometry, &bank));
    assert_ok(c, model_frame(t, m, scene.body, scene.geometry, &bank, scene.target, 0, 0, &frame));
    tensor *zero = tape_zeros(t, T_F32, frame->rank, frame->dim);
    assert_ok(c, tape_backward(t, op_mean_square(t, frame, zero, NULL), 1));
    every_weight_has_a_gradient(preset, m);
    tape_free(t);
    rival_weights_free(&s.w);
    model_free(m);
    rival_scene_close(&scene);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void rows_of_the_ablation_agree(void **state) {
    agrees(TINY ",use_point=0,use_pixel=0,fusion=1", 2e-6);
    agrees(TINY ",use_pixel=0,fusion=1", 2e-6);
    agrees(TINY ",use_point=0,fusion=1", 2e-6);
    agrees(TINY ",use_global=0,fusion=1", 2e-6);
    agrees(TINY ",fusion=1", 2e-6);
}

static void fair_concatenation_agrees(void **state) {
    agrees(TINY ",fusion=2", 2e-6);
    agrees(TINY ",use_global=0,use_point=0,fusion=2", 2e-6);
}

/* ---- fusion by style ---- */
enum { POINTS = 12 }; /* points whose gradients are compared */
typedef struct {
    second *second;
    float *value[5]; /* planes, pixel, volume: a copy of each point's */
    int channels;
} second_points;

/* sum over points of mix * fused */
static double second_sum(void *self, const void *arg) {
    const second_points *p = self;
    const double *mix = arg;
    second *s = p->second;
    double sum = 0, out[2 * WIDTH];
    for (int i = 0; i < POINTS; i++) {
        for (int k = 0; k < 3; k++) s->plane[k] = p->value[k] + i * WIDTH;
        s->pixel = p->value[3] + i * PIXEL;
        s->volume = p->value[4] + i * p->channels;
        second_fused(s, out);
        for (int k = 0; k < 2 * WIDTH; k++) sum += mix[i * 2 * WIDTH + k] * out[k];
    }
    return sum;
}

static float *copied(const tensor *x) {
    const size_t bytes = POINTS * (size_t)tensor_columns(x) * sizeof(float);
    float *copy = malloc(bytes);
    return memcpy(copy, tensor_f32(x), bytes);
}

/* The gradients of the fusion's weights equal the differences of the second implementation. */
static void gradients_agree(const char *preset) {
    context *c = test_context();
    rival_scene scene;
    model_config config;
    model *m;
    model_bank bank;
    point_outputs out;
    assert_ok(c, model_config_parse(c, preset, &config));
    rival_scene_open(c, &config, 1, RAYS, &scene);
    assert_ok(c, model_create(c, &config, 7, &m));
    rival_shake(m);
    assert_ok(c, parameters_make_grads(c, m->weights));
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true, .training = true});
    assert_ok(c, model_encode(t, m, scene.body, scene.geometry, &bank));
    assert_ok(c, model_sherf_points(t, m, scene.body, scene.geometry, &bank, scene.target->points, 0, POINTS,
                                    &out));
    tensor *pixel =
        pixel_sample(t, &model_sherf_network(m)->pixel, &bank, scene.target->points->observed_px, POINTS);
    second s = {.k = model_sherf_settings(&config)};
    second_points p = {.second = &s, .channels = (int)tensor_columns(out.volume)};
    for (int k = 0; k < 3; k++) p.value[k] = copied(out.plane[k]);
    p.value[3] = copied(pixel);
    p.value[4] = copied(out.volume);
    double mix[POINTS * 2 * WIDTH];
    float *grad = tensor_f32(tape_grad(t, out.fusion));
    for (int i = 0; i < POINTS * 2 * WIDTH; i++)
        grad[i] = (float)(mix[i] = (float)random_normal(79, (uint64_t)i));
    assert_ok(c, tape_backward_seeded(t));
    rival_weights_take(m, &s.w);
    int kept = 0; /* the fusion's */
    for (int i = 0; i < s.w.count; i++) {
        const char *name = s.w.item[i].name;
        if (!strncmp(name, "renderer.", 9) && strncmp(name, "renderer.encoder_3d.", 20))
            s.w.item[kept++] = s.w.item[i];
        else
            free(s.w.item[i].v);
    }
    s.w.count = kept;
    rival_gradients_agree(m, &s.w, 8, 1e-4, second_sum, &p, mix);
    for (int k = 0; k < 5; k++) free(p.value[k]);
    tape_free(t);
    rival_weights_free(&s.w);
    model_free(m);
    rival_scene_close(&scene);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void fusion_by_style_agrees(void **state) {
    agrees(TINY ",fusion=3", 2e-6);
    agrees(TINY ",fusion=4", 2e-5); /* sines of 30 times a rounded sum */
    agrees(TINY ",fusion=5", 2e-6);
    gradients_agree(TINY ",fusion=3");
    gradients_agree(TINY ",fusion=4");
    gradients_agree(TINY ",fusion=5");
}

/* ---- what is declared ---- */
static int64_t count_of(context *c, const char *preset) {
    model_config config;
    model *m;
    assert_ok(c, model_config_parse(c, preset, &config));
    assert_ok(c, model_shape(c, &config, &m));
    const int64_t n = parameters_trained_count(m->weights);
    model_free(m);
    return n;
}

/* The transformer has 8,416 weights in addition to the projection's 3,104; fair concatenation has 6,208
 * instead. */
static void counts(void **state) {
    context *c = test_context();
    const int64_t whole = count_of(c, "paper");
    assert_int_equal(whole - count_of(c, "paper,fusion=1"), 8416);
    assert_int_equal(whole - count_of(c, "paper,fusion=2"), 8416 - 6208);
    const int64_t projection = 3104; /* these presets have no projection */
    assert_int_equal(whole - count_of(c, "paper,fusion=3"), 8416 + projection - 10400);
    assert_int_equal(whole - count_of(c, "paper,fusion=4"), 8416 + projection - 14624);
    assert_int_equal(whole - count_of(c, "paper,fusion=5"), 8416 + projection - 14624);
    assert_int_equal(
        count_of(c, "paper,use_global=0,use_point=0"), /* the map's encoder, transformer, decoder */
        count_of(c, "paper,use_global=0,use_point=0,fusion=1") + 8416);
    const int64_t one = count_of(c, "paper,use_global=0,use_point=0,fusion=1"),
                  two = count_of(c, "paper,use_global=0,fusion=1"), three = count_of(c, "paper,fusion=1");
    const int64_t global = count_of(c, "paper,use_point=0,fusion=1") - one - (64 * 32 + 32);
    assert_int_equal(three - two, global + 32 * 32); /* a wider projection */
    model_config config;
    assert_ok(c, model_config_parse(c, "paper", &config));
    assert_true(model_sherf_is_fused(&config));
    assert_ok(c, model_config_parse(c, "paper,fusion=1", &config));
    assert_false(model_sherf_is_fused(&config));
    assert_fails(c, model_config_parse(c, "small,use_global=0,use_point=0,use_pixel=0", &config),
                 SHERF_BAD_ARGUMENT, "no feature left");
    assert_fails(c, model_config_parse(c, "small,use_point=0,fusion=4", &config), SHERF_BAD_ARGUMENT,
                 "fusion=4");
    assert_fails(c, model_config_parse(c, "small,fusion=6", &config), SHERF_BAD_ARGUMENT, "fusion=6");
    sherf_context_free(c);
}

/* ---- use ---- */
static void avatars_of_variants(void **state) {
    rival_use(TINY ",use_point=0,use_pixel=0,fusion=1");
    rival_use(TINY ",use_global=0");
    rival_moves(TINY ",fusion=2");
    rival_use(TINY ",fusion=3");
    rival_moves(TINY ",fusion=4");
}

static void every_allocation_fails(void **state) {
    rival_no_memory(TINY ",use_global=0,use_pixel=0,fusion=2,samples=2");
}

static void a_variant_trains(void **state) {
    rival_trains(TINY ",use_global=0,fusion=2", 20, 0.9);
    rival_goes_on(TINY ",use_point=0,fusion=1");
    rival_trains(TINY ",fusion=3", 20, 0.9);
    rival_trains(TINY ",fusion=4", 20, 0.95);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(rows_of_the_ablation_agree),
                                       cmocka_unit_test(fair_concatenation_agrees),
                                       cmocka_unit_test(fusion_by_style_agrees),
                                       cmocka_unit_test(counts),
                                       cmocka_unit_test(avatars_of_variants),
                                       cmocka_unit_test(every_allocation_fails),
                                       cmocka_unit_test(a_variant_trains)};
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
