/* SHERF without some of its features or its transformer: what the decoder reads, what is declared, use. */
#include <math.h>
#include <stdio.h>

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

/* What the decoder reads of a point, 64 numbers or the first 64 of 96. */
static void second_fused(const second *s, double out[2 * WIDTH]) {
    double token[3][WIDTH];
    second_tokens(s, token);
    if (s->k->fusion == FUSION_FAIR)
        rival_linear(&s->w, "renderer.fair", 3 * WIDTH, token[0], 2 * WIDTH, out);
    else
        memcpy(out, token[0], 2 * WIDTH * sizeof *out);
}

/* Each point's fused tokens are those of the definition, and every weight that is declared takes part. */
static void agrees(const char *preset) {
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
    tensor_f32(model_tensor(m, "decoder.alpha_linear.bias"))[0] += 8; /* points are seen */
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
    assert_int_equal(columns, s.k->fusion == FUSION_FAIR ? 2 * WIDTH : 3 * WIDTH);
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
    if (!(largest > 0.01 && worst < 2e-6 * largest)) fail_msg("%s: %g apart of %g", preset, worst, largest);
    assert_true(!out.plane[0] == !s.k->use_global && !out.volume == !s.k->use_point);
    tape_reset(t);
    assert_ok(c, model_encode(t, m, scene.body, scene.geometry, &bank));
    assert_ok(c, model_frame(t, m, scene.body, scene.geometry, &bank, scene.target, 0, 0, &frame));
    tensor *zero = tape_zeros(t, T_F32, frame->rank, frame->dim);
    assert_ok(c, tape_backward(t, op_mean_square(t, frame, zero, NULL), 1));
    for (int i = 0; i < m->weights->count; i++) {
        const parameter *q = m->weights->item[i];
        /* 32 pixels are one in the global encoder's last stage, and batch norm of one is constant. */
        bool any = q->buffer || !strncmp(q->name, "encoder_2d.", 11);
        for (int64_t k = 0; k < tensor_count(&q->value) && !any; k++)
            any = m->weights->grads[q->offset + k] != 0;
        if (!any) fail_msg("%s: %s has no gradient", preset, q->name);
    }
    tape_free(t);
    rival_weights_free(&s.w);
    model_free(m);
    rival_scene_close(&scene);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void rows_of_the_ablation_agree(void **state) {
    agrees(TINY ",use_point=0,use_pixel=0,fusion=1");
    agrees(TINY ",use_pixel=0,fusion=1");
    agrees(TINY ",use_point=0,fusion=1");
    agrees(TINY ",use_global=0,fusion=1");
    agrees(TINY ",fusion=1");
}

static void fair_concatenation_agrees(void **state) {
    agrees(TINY ",fusion=2");
    agrees(TINY ",use_global=0,use_point=0,fusion=2");
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

/* The transformer has 8,416 weights beside the projection's 3,104, fair concatenation 6,208 in its place. */
static void counts(void **state) {
    context *c = test_context();
    const int64_t whole = count_of(c, "paper");
    assert_int_equal(whole - count_of(c, "paper,fusion=1"), 8416);
    assert_int_equal(whole - count_of(c, "paper,fusion=2"), 8416 - 6208);
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
    sherf_context_free(c);
}

/* ---- use ---- */
static void avatars_of_variants(void **state) {
    rival_use(TINY ",use_point=0,use_pixel=0,fusion=1");
    rival_use(TINY ",use_global=0");
    rival_moves(TINY ",fusion=2");
}

static void every_allocation_fails(void **state) {
    rival_no_memory(TINY ",use_global=0,use_pixel=0,fusion=2,samples=2");
}

static void a_variant_trains(void **state) {
    rival_trains(TINY ",use_global=0,fusion=2", 20, 0.9);
    rival_goes_on(TINY ",use_point=0,fusion=1");
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(rows_of_the_ablation_agree),
                                       cmocka_unit_test(fair_concatenation_agrees),
                                       cmocka_unit_test(counts),
                                       cmocka_unit_test(avatars_of_variants),
                                       cmocka_unit_test(every_allocation_fails),
                                       cmocka_unit_test(a_variant_trains)};
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
