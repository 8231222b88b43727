/* Tests of PixelNeRF against a second implementation, in double and written only from its description: values
 * and gradients of whole frames, from the picture to the rays; and of what the model can and cannot do. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "io/safetensors.h"
#include "model/model.h"
#include "rival.h"
#include "support.h"

/* ---- the second implementation ---- */
enum { SIDE = 32, WIDTH = 16, ENCODER = 8, FEATURES = 8 * ENCODER, RAYS = 10 };

typedef struct {
    int passes, pool, samples, drawn, around;
    bool own;
    float dense; /* added to the raw density, so that something is visible */
} variant;

typedef struct {
    const rival_scene *scene;
    variant v;
    rival_weights w;
    double middle[3];
    /* the target's drawn rays, by pass; made once, then fixed */
    struct {
        int ray, count[2];
        double depth[2][64], way[2][64];
    } ray[RAYS];
    int rays;
    bool fixed;
} second;

/* ResNet-18 up to its third stage; the stages are resized to the size of the first and concatenated: [16, 16,
 * 64]. */
static double *features_of(second *s) {
    rival_map x = rival_image(s->scene->observation, 2, -1), stage[4];
    x = rival_conv_norm(&s->w, x, "encoder.conv1", "encoder.bn1", 2, 3, true);
    stage[0] = rival_map_copy(x);
    if (s->v.pool) x = rival_max_pool(x);
    for (int i = 1; i < 4; i++) {
        x = rival_resnet_stage(&s->w, x, "encoder", i, 2);
        stage[i] = rival_map_copy(x);
    }
    free(x.v);
    return rival_side_by_side(4, stage).v;
}

/* h + fc1(relu(fc0(relu h))), five times; features are added before the first three. out: r, g, b, raw
 * density. */
static void field(second *s, const char *net, const double code[42], const double *feature, double out[4]) {
    char name[64];
    double h[WIDTH], x[WIDTH], y[WIDTH];
    snprintf(name, sizeof name, "%s.in", net);
    rival_linear(&s->w, name, 42, code, WIDTH, h);
    for (int b = 0; b < 5; b++) {
        if (b < 3) {
            snprintf(name, sizeof name, "%s.feature.%d", net, b);
            rival_linear(&s->w, name, FEATURES, feature, WIDTH, x);
            for (int i = 0; i < WIDTH; i++) h[i] += x[i];
        }
        memcpy(x, h, sizeof x);
        for (int k = 0; k < 2; k++) {
            for (int i = 0; i < WIDTH; i++) x[i] = fmax(x[i], 0);
            snprintf(name, sizeof name, "%s.block.%d.%d", net, b, k);
            rival_linear(&s->w, name, WIDTH, x, WIDTH, y);
            memcpy(x, y, sizeof x);
        }
        for (int i = 0; i < WIDTH; i++) h[i] += x[i];
    }
    for (int i = 0; i < WIDTH; i++) h[i] = fmax(h[i], 0);
    snprintf(name, sizeof name, "%s.out", net);
    rival_linear(&s->w, name, WIDTH, h, 4, out);
    for (int k = 0; k < 3; k++) out[k] = 1 / (1 + exp(-out[k]));
}

/* One sample of a ray: color and raw density. */
static void sample(second *s, const char *net, double *map, int ray, double depth, double out[4]) {
    const ray_bundle *r = s->scene->target->rays;
    const sherf_camera *k = &s->scene->camera;
    double d[3], x[3], unit[3], code[42], pixel[3], feature[FEATURES];
    const double length = rival_direction(r, ray, d);
    for (int i = 0; i < 3; i++) {
        x[i] = r->origin_world[i] + depth * d[i];
        unit[i] = d[i] / length;
    }
    for (int i = 0; i < 3; i++) {
        double p = 0, q = 0, c = k->T_m[i];
        for (int j = 0; j < 3; j++) {
            p += k->R[3 * i + j] * (x[j] - s->middle[j]);
            q += k->R[3 * i + j] * unit[j];
            c += k->R[3 * i + j] * x[j];
        }
        code[i] = p;
        code[39 + i] = q;
        pixel[i] = c;
        for (int f = 0; f < 6; f++) {
            code[3 + 6 * f + i] = sin(1.5 * pow(2, f) * p);
            code[6 + 6 * f + i] = cos(1.5 * pow(2, f) * p);
        }
    }
    const double u = (k->K[0] * pixel[0] + k->K[1] * pixel[1] + k->K[2] * pixel[2]) / (pixel[2] + 1e-5);
    const double v = (k->K[4] * pixel[1] + k->K[5] * pixel[2]) / (pixel[2] + 1e-5);
    const rival_map all = {SIDE / 2, SIDE / 2, FEATURES, map};
    rival_bilinear(all, fmin(fmax(u / 2, 0), SIDE / 2 - 1), fmin(fmax(v / 2, 0), SIDE / 2 - 1), feature);
    field(s, net, code, feature, out);
}

/* The depths of the second pass and the interval after each. weight [count]: of the first pass's samples. */
static void fine_depths(second *s, int n, const double *weight, const double *sigma) {
    const ray_bundle *r = s->scene->target->rays;
    const int S = s->v.samples, ray = s->ray[n].ray;
    double near = r->near[ray], far = r->far[ray], d[3], total = 0, seen = 0, mean = 0, sum[65] = {0};
    const double length = rival_direction(r, ray, d), *t = s->ray[n].depth[0];
    double *out = s->ray[n].depth[1];
    int count = 0;
    for (int i = 0; i < S; i++) {
        total += weight[i] + 1e-5;
        seen += weight[i];
        mean += weight[i] * t[i];
        out[count++] = t[i];
    }
    mean = seen > 1e-6 ? mean / seen : far;
    for (int i = 0; i < S; i++) sum[i + 1] = sum[i] + (weight[i] + 1e-5) / total;
    for (int j = 0; j < s->v.drawn; j++) {
        const double u = (j + 0.5) / s->v.drawn;
        int i = 0;
        while (i + 1 < S && sum[i + 1] <= u) i++;
        out[count++] = near + (far - near) * (i + (u - sum[i]) / (sum[i + 1] - sum[i])) / S;
    }
    for (int j = 0; j < s->v.around; j++) {
        const double z = random_normal(random_key(0, "depths.fine", 2), (uint64_t)ray * 64 + (uint64_t)j);
        out[count++] = fmin(fmax(mean + 0.01 / length * z, near), far);
    }
    qsort(out, (size_t)count, sizeof *out, rival_ascending);
    s->ray[n].count[1] = count;
    for (int i = 0; i < count; i++) s->ray[n].way[1][i] = (i + 1 < count ? out[i + 1] : far) - out[i];
}

/* [rays][2 passes][r, g, b, opacity] */
static void second_frame(second *s, double out[RAYS][2][4]) {
    static const char *const net[2] = {"coarse", "fine"};
    double *map = features_of(s);
    for (int n = 0; n < s->rays; n++)
        for (int pass = 0; pass < s->v.passes; pass++) {
            double sigma[64], rgb[64][3], weight[64], d[3];
            const double length = rival_direction(s->scene->target->rays, s->ray[n].ray, d);
            for (int i = 0; i < s->ray[n].count[pass]; i++) {
                double y[4];
                sample(s, net[pass], map, s->ray[n].ray, s->ray[n].depth[pass][i], y);
                memcpy(rgb[i], y, sizeof rgb[i]);
                sigma[i] = y[3];
            }
            rival_composite(s->ray[n].count[pass], sigma, &rgb[0][0], s->ray[n].way[pass], length, weight,
                            out[n][pass]);
            if (!pass && s->v.passes == 2 && !s->fixed) fine_depths(s, n, weight, sigma);
        }
    s->fixed = true;
    free(map);
}

/* Stratified middles, with the last interval up to the end of the box; or the kept ones of even depths, with
 * an infinite last interval. */
static void first_depths(second *s) {
    const ray_bundle *r = s->scene->target->rays;
    const point_set *p = s->scene->target->points;
    const int S = s->v.samples;
    for (int n = 0; n < (int)p->rays; n++) {
        if (!r->at_box[n]) continue;
        const double near = r->near[n], far = r->far[n];
        assert_true(s->rays < RAYS);
        s->ray[s->rays].ray = n;
        for (int64_t i = p->first[n]; i < p->first[n + 1]; i++) {
            const int k = s->ray[s->rays].count[0]++, at = p->sample[i];
            const double even = (far - near) / (S - 1);
            s->ray[s->rays].depth[0][k] = s->v.own ? near + (far - near) * (at + 0.5) / S : near + even * at;
            s->ray[s->rays].way[0][k] = s->v.own     ? (far - near) / S * (at + 1 < S ? 1 : 0.5)
                                        : at + 1 < S ? even
                                                     : 1e10;
        }
        s->rays++;
    }
}

/* ---- compared with the model ---- */
static double of_frame(double out[RAYS][2][4], const second *s, const double mix[RAYS][2][4]) {
    double sum = 0;
    for (int n = 0; n < s->rays; n++)
        for (int pass = 0; pass < s->v.passes; pass++)
            for (int k = 0; k < 4; k++) sum += mix[n][pass][k] * out[n][pass][k];
    return sum;
}

static double second_sum(void *arg, const void *mix) {
    second *s = arg;
    double out[RAYS][2][4];
    second_frame(s, out);
    return of_frame(out, s, mix);
}

/* The model's frames on a training tape, compared with `want`; gradients of the mixed sum. */
static void model_agrees(context *c, model *m, second *s, double want[RAYS][2][4],
                         const double mix[RAYS][2][4]) {
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true, .training = true});
    model_bank bank;
    tensor *frame;
    assert_ok(c, model_encode(t, m, s->scene->body, s->scene->geometry, &bank));
    assert_ok(c,
              model_frame(t, m, s->scene->body, s->scene->geometry, &bank, s->scene->target, 0, 0, &frame));
    assert_true((bank.coarse != NULL) == (s->v.passes == 2));
    double opaque = 0;
    for (int n = 0; n < s->rays; n++)
        for (int pass = 0; pass < s->v.passes; pass++) {
            tensor *of = pass + 1 == s->v.passes ? frame : bank.coarse;
            const float *got = tensor_f32(of) + 5 * s->ray[n].ray;
            float *grad = tensor_f32(tape_grad(t, of)) + 5 * s->ray[n].ray;
            for (int k = 0; k < 4; k++) {
                if (fabs(got[k] - want[n][pass][k]) > 5e-6)
                    fail_msg("ray %d, pass %d: %g, not %g", n, pass, got[k], want[n][pass][k]);
                grad[k] = (float)mix[n][pass][k];
            }
            opaque += want[n][pass][3] / s->rays / s->v.passes;
        }
    if (!(opaque > 0.2 && opaque < 0.98)) fail_msg("opacity %g", opaque);
    assert_ok(c, tape_backward_seeded(t));
    tape_free(t);
}

static void agrees(const char *preset, variant v) {
    context *c = test_context();
    rival_scene scene;
    model_config config;
    model *m;
    assert_ok(c, model_config_parse(c, preset, &config));
    rival_scene_open(c, &config, 0, RAYS, &scene);
    assert_ok(c, model_create(c, &config, 7, &m));
    rival_shake(m);
    tensor_f32(model_tensor(m, "coarse.out.bias"))[3] += v.dense;
    if (v.passes == 2) tensor_f32(model_tensor(m, "fine.out.bias"))[3] += v.dense;
    assert_ok(c, parameters_make_grads(c, m->weights));
    second s = {.scene = &scene, .v = v};
    rival_weights_take(m, &s.w);
    rival_box_middle(c, &scene, s.middle);
    first_depths(&s);
    double want[RAYS][2][4], mix[RAYS][2][4];
    for (int i = 0; i < RAYS * 8; i++) (&mix[0][0][0])[i] = random_normal(77, (uint64_t)i);
    second_frame(&s, want);
    model_agrees(c, m, &s, want, mix);
    rival_gradients_agree(m, &s.w, 2, 5e-5, second_sum, &s, mix);
    rival_weights_free(&s.w);
    model_free(m);
    rival_scene_close(&scene);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

#define TINY "encoder=18,encoder_width=8,width=16,"
static void two_passes_agree(void **state) {
    agrees("pixelnerf:own," TINY "pool=0,samples=8,drawn=5,around=3", (variant){2, 0, 8, 5, 3, true, 1});
}
static void one_pass_agrees(void **state) {
    agrees("pixelnerf:own-small," TINY "samples=9", (variant){1, 1, 9, 0, 0, true, 3});
}
static void the_shell_agrees(void **state) {
    agrees("pixelnerf:matched," TINY "samples=24", (variant){1, 1, 24, 0, 0, false, 10});
}

/* ---- counts and settings ---- */
static void counts_are_those_of_the_papers(void **state) {
    static const rival_count known[] = {{"pixelnerf:own", 8170304 + 2 * 3438596},
                                        {"pixelnerf:matched", 8170304 + 3438596},
                                        {"pixelnerf:own-small", 2782784 + 368132},
                                        {"pixelnerf:matched-small", 3150916}};
    rival_counts(COUNT_OF(known), known);
}

static void settings_that_do_not_go_together(void **state) {
    context *c = test_context();
    model_config k;
    assert_fails(c, model_config_parse(c, "pixelnerf:own,encoder=20", &k), SHERF_BAD_ARGUMENT,
                 "must be 18 or 34");
    assert_fails(c, model_config_parse(c, "pixelnerf:own,shell=1", &k), SHERF_BAD_ARGUMENT, "knows no body");
    assert_fails(c, model_config_parse(c, "pixelnerf:matched,passes=2", &k), SHERF_BAD_ARGUMENT, "passes=2");
    assert_ok(c, model_config_parse(c, "pixelnerf:matched-small", &k));
    assert_null(model_recipe(&k));
    assert_int_equal(k.samples, 48);
    assert_ok(c, model_config_parse(c, "pixelnerf:own-small", &k));
    assert_true(model_recipe(&k)->rays == 128 && k.samples == 64);
    assert_ok(c, model_config_parse(c, "small", &k));
    assert_null(model_recipe(&k));
    sherf_context_free(c);
}

/* Drawn rays are distinct and meet the box. There are as many as requested, and as many in the mask as
 * requested if it has enough. Exactly their samples are points, in order. */
static void rays_are_drawn(void **state) {
    context *c = test_context();
    model_config config;
    rival_scene s;
    assert_ok(c, model_config_parse(c, "pixelnerf:own,samples=5", &config));
    rival_scene_open(c, &config, 0, 40, &s);
    const ray_bundle *r = s.target->rays;
    const point_set *p = s.target->points;
    int met = 0, inside = 0;
    sherf_observation *shown;
    rival_observation(c, 0, 1, NULL, &shown);
    for (int n = 0; n < SIDE * SIDE; n++) {
        met += r->at_box[n];
        inside += r->at_box[n] && shown->mask[n];
        assert_int_equal(p->first[n + 1] - p->first[n], r->at_box[n] ? 5 : 0);
    }
    assert_int_equal(met, 40);
    assert_int_equal(inside, 28);
    for (int64_t i = 0; i < p->count; i++) {
        float x[3];
        const int n = p->ray[i];
        const float depth = r->near[n] + (r->far[n] - r->near[n]) * (float)p->sample[i] / 4;
        assert_int_equal(p->sample[i], i - p->first[n]);
        point_world(p, i, x);
        for (int k = 0; k < 3; k++)
            assert_true(fabsf(x[k] - r->origin_world[k] - depth * r->direction[3 * n + k]) < 2e-6f);
    }
    /* more than the mask has, and more than there are */
    target_geometry *all, *some;
    point_set *too_many;
    const sherf_camera *camera = sherf_observation_camera(shown);
    const sherf_pose *pose = sherf_observation_pose(shown);
    const ray_draw max = {.count = 1 << 20, .inside = 1, .mask = shown->mask, .key = 2};
    assert_ok(c, target_geometry_create(c, &config, s.body, camera, pose, s.geometry, false, &all));
    assert_ok(c, target_geometry_draw(c, &config, s.body, camera, pose, s.geometry, &max, &some));
    assert_memory_equal(all->rays->at_box, some->rays->at_box, SIDE * SIDE);
    target_geometry_free(all);
    target_geometry_free(some);
    assert_int_equal(points_of_box(c, r, 4097, &too_many), SHERF_BAD_ARGUMENT);
    sherf_observation_free(shown);
    rival_scene_close(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- use ---- */
#define USED "pixelnerf:own-small," TINY "pool=0,samples=16,passes=2,drawn=4,around=4"

static void an_avatar_shows_the_observed_pose(void **state) {
    rival_use(USED);
}

static void what_it_cannot_do_is_one_line(void **state) {
    context *c = test_context();
    sherf_model *m;
    sherf_body *body;
    sherf_observation *o;
    sherf_avatar *a;
    sherf_frame f = {0};
    char line[200];
    assert_ok(c, sherf_model_create(c, USED, 3, &m));
    rival_observation(c, 0, 0, &body, &o);
    assert_ok(c, sherf_avatar_create(c, m, body, o, &a));
    sherf_pose pose = *sherf_observation_pose(o);
    pose.poses_rad[3] += 5e-5f; /* an error like that of writing to text and reading back */
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF};
    assert_ok(c, sherf_render(c, a, body, &pose, sherf_observation_camera(o), &exact, &f));
    pose.poses_rad[3] += 0.1f;
    snprintf(line, sizeof line, "model pixelnerf has no canonical space: it shows the observed pose alone");
    assert_fails(c, sherf_render(c, a, body, &pose, sherf_observation_camera(o), &exact, &f),
                 SHERF_UNSUPPORTED, line);
    const sherf_export_options options = {0};
    assert_fails(c, sherf_export(c, a, body, &options, test_path("a.glb"), NULL), SHERF_UNSUPPORTED, line);
    sherf_frame_free(&f);
    sherf_avatar_free(a);
    sherf_observation_free(o);
    sherf_body_free(body);
    sherf_model_free(m);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void every_allocation_fails(void **state) {
    rival_no_memory("pixelnerf:own-small," TINY "pool=0,samples=2,passes=2,drawn=1,around=1");
}

static void it_trains_as_its_authors_do(void **state) {
    rival_trains(USED, 100, 0.65);
}
static void it_trains_as_sherf_does(void **state) {
    rival_trains("pixelnerf:matched-small," TINY "pool=0,samples=24", 60, 0.8);
}
static void it_goes_on_with_the_same_bits(void **state) {
    rival_goes_on(USED);
}

static void it_is_scored_in_the_observed_pose(void **state) {
    rival_is_scored(USED, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(two_passes_agree),
                                       cmocka_unit_test(one_pass_agrees),
                                       cmocka_unit_test(the_shell_agrees),
                                       cmocka_unit_test(counts_are_those_of_the_papers),
                                       cmocka_unit_test(settings_that_do_not_go_together),
                                       cmocka_unit_test(rays_are_drawn),
                                       cmocka_unit_test(an_avatar_shows_the_observed_pose),
                                       cmocka_unit_test(what_it_cannot_do_is_one_line),
                                       cmocka_unit_test(every_allocation_fails),
                                       cmocka_unit_test(it_trains_as_its_authors_do),
                                       cmocka_unit_test(it_trains_as_sherf_does),
                                       cmocka_unit_test(it_goes_on_with_the_same_bits),
                                       cmocka_unit_test(it_is_scored_in_the_observed_pose)};
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
