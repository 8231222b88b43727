/* Tests of MPS-NeRF against a second implementation, in double and written only from its description: values
 * and gradients of whole frames, in the observed pose and in another; and of its use. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rival.h"

enum { SIDE = 32, MAP = 16, POINT = MAP + 27, VALUE = 24, MLP = 16, WIDTH = 16, VIEW = 8, RAYS = 10 };

typedef struct {
    const rival_scene *scene;
    rival_weights w;
    bool own;
    int rays, ray[RAYS];
} second;

static rival_map halved(rival_map x) {
    rival_map y = {x.height / 2, x.width / 2, 3, malloc((size_t)(x.height * x.width / 4 * 3) * sizeof *y.v)};
    for (int i = 0; i < y.height; i++)
        for (int j = 0; j < y.width; j++)
            for (int c = 0; c < 3; c++) {
                double sum = 0;
                for (int k = 0; k < 4; k++) sum += x.v[((2 * i + k / 2) * x.width + 2 * j + k % 2) * 3 + c];
                y.v[(i * y.width + j) * 3 + c] = sum / 4;
            }
    free(x.v);
    return y;
}

static void waves(const double x[3], int frequencies, double *out) {
    for (int k = 0; k < 3; k++) {
        out[k] = x[k];
        for (int n = 0; n < frequencies; n++) {
            out[3 + 6 * n + k] = sin(pow(2, n) * M_PI * x[k]);
            out[6 + 6 * n + k] = cos(pow(2, n) * M_PI * x[k]);
        }
    }
}

static void at_px(rival_map map, const double px[2], double *out) {
    rival_bilinear(map, fmin(fmax(px[0] / SIDE * (map.width - 1), 0), map.width - 1),
                   fmin(fmax(px[1] / SIDE * (map.height - 1), 0), map.height - 1), out);
}

static void normed(second *s, int layer, int which, const double *x, double *y) {
    const double *gain = rival_weight(&s->w, "fusion.%d.norm.%d.weight", layer, which);
    const double *bias = rival_weight(&s->w, "fusion.%d.norm.%d.bias", layer, which);
    double mean = 0, variance = 0;
    for (int i = 0; i < POINT; i++) mean += x[i] / POINT;
    for (int i = 0; i < POINT; i++) variance += pow(x[i] - mean, 2) / POINT;
    for (int i = 0; i < POINT; i++) y[i] = (x[i] - mean) / sqrt(variance + 1e-5) * gain[i] + bias[i];
}

static void fuse(second *s, double token[POINT]) {
    double x[POINT], y[POINT], hidden[VALUE > MLP ? VALUE : MLP];
    char name[64];
    for (int l = 0; l < 2; l++) {
        const double *value = rival_weight(&s->w, "fusion.%d.value.weight", l);
        normed(s, l, 0, token, x);
        for (int o = 0; o < VALUE; o++) {
            hidden[o] = 0;
            for (int i = 0; i < POINT; i++) hidden[o] += value[o * POINT + i] * x[i];
        }
        snprintf(name, sizeof name, "fusion.%d.out", l);
        rival_linear(&s->w, name, VALUE, hidden, POINT, y);
        for (int i = 0; i < POINT; i++) token[i] += y[i];
        normed(s, l, 1, token, x);
        snprintf(name, sizeof name, "fusion.%d.mlp.0", l);
        rival_linear(&s->w, name, POINT, x, MLP, hidden);
        for (int i = 0; i < MLP; i++) hidden[i] *= (1 + erf(hidden[i] / sqrt(2))) / 2;
        snprintf(name, sizeof name, "fusion.%d.mlp.1", l);
        rival_linear(&s->w, name, MLP, hidden, POINT, y);
        for (int i = 0; i < POINT; i++) token[i] += y[i];
    }
}

static void point(second *s, rival_map map, rival_map image, const float canonical[3], const double px[2],
                  double out[4]) {
    double token[POINT], rgb[3], x[39 + POINT], h[WIDTH + 39 + POINT], y[WIDTH], c[WIDTH + POINT];
    const double place[3] = {canonical[0], canonical[1], canonical[2]};
    char name[64];
    at_px(map, px, token);
    at_px(image, px, rgb);
    waves(rgb, 4, token + MAP);
    fuse(s, token);
    waves(place, 6, x);
    memcpy(x + 39, token, sizeof token);
    memcpy(h, x, sizeof x);
    for (int i = 0, in = 39 + POINT; i < 8; i++) {
        snprintf(name, sizeof name, "decoder.hidden.%d", i);
        rival_linear(&s->w, name, in, h, WIDTH, y);
        double *to = h;
        in = WIDTH;
        if (i == 4) { /* skip connection: the input comes first, then this layer's own input */
            memcpy(h, x, sizeof x);
            to = h + 39 + POINT;
            in += 39 + POINT;
        }
        for (int k = 0; k < WIDTH; k++) to[k] = fmax(y[k], 0);
    }
    rival_linear(&s->w, "decoder.density", WIDTH, h, 1, &out[3]);
    if (s->own) out[3] = log(1 + exp(out[3] - 1));
    rival_linear(&s->w, "decoder.feature", WIDTH, h, WIDTH, c);
    memcpy(c + WIDTH, token, sizeof token);
    rival_linear(&s->w, "decoder.view", WIDTH + POINT, c, VIEW, y);
    for (int i = 0; i < VIEW; i++) y[i] = fmax(y[i], 0);
    rival_linear(&s->w, "decoder.color", VIEW, y, 3, out);
    for (int k = 0; k < 3; k++) out[k] = 1.0002 / (1 + exp(-out[k])) - 0.0001;
}

/* Where the observation shows a canonical point. */
static void seen_at(const second *s, const float *canonical, double px[2]) {
    const sherf_camera *k = &s->scene->camera;
    const int32_t nearest = vertex_grid_nearest(body_canonical_grid(s->scene->body), canonical, NULL);
    float x[3];
    double c[3];
    deform_from_canonical(s->scene->body, s->scene->geometry->body, 1, canonical, &nearest, x);
    for (int i = 0; i < 3; i++)
        c[i] = (double)k->R[3 * i] * x[0] + (double)k->R[3 * i + 1] * x[1] + (double)k->R[3 * i + 2] * x[2] +
               k->T_m[i];
    for (int i = 0; i < 2; i++)
        px[i] = (k->K[3 * i] * c[0] + k->K[3 * i + 1] * c[1] + k->K[3 * i + 2] * c[2]) / (c[2] + 1e-5);
}

static void second_frame(second *s, double out[RAYS][4]) {
    const ray_bundle *r = s->scene->target->rays;
    const point_set *p = s->scene->target->points;
    rival_map image = rival_image(s->scene->observation, 1, 0), stage[2];
    stage[0] =
        rival_conv_norm(&s->w, halved(rival_map_copy(image)), "encoder.conv1", "encoder.bn1", 2, 3, true);
    stage[1] = rival_resnet_stage(&s->w, rival_map_copy(stage[0]), "encoder", 1, 3);
    rival_map map = rival_side_by_side(2, stage);
    for (int n = 0; n < s->rays; n++) {
        const int ray = s->ray[n];
        double sigma[64], rgb[64][3], way[64], weight[64], d[3], px[2], y[4];
        const double length = rival_direction(r, ray, d);
        const double step = ((double)r->far[ray] - r->near[ray]) / (p->samples - 1);
        int count = 0;
        for (int64_t i = p->first[ray]; i < p->first[ray + 1]; i++, count++) {
            seen_at(s, p->canonical + 3 * i, px);
            point(s, map, image, p->canonical + 3 * i, px, y);
            memcpy(rgb[count], y, sizeof rgb[count]);
            sigma[count] = y[3];
            way[count] = p->sample[i] + 1 < p->samples ? step : 1e10;
        }
        rival_composite(count, sigma, &rgb[0][0], way, length, weight, out[n]);
    }
    free(image.v);
    free(map.v);
}

static double second_sum(void *arg, const void *mix) {
    second *s = arg;
    double out[RAYS][4], sum = 0;
    second_frame(s, out);
    for (int n = 0; n < s->rays; n++)
        for (int k = 0; k < 4; k++) sum += ((const double *)mix)[4 * n + k] * out[n][k];
    return sum;
}

#define TINY "encoder_width=8,value_width=24,mlp_width=16,width=16,view_width=8,"

static void agrees(const char *preset, int pose, bool own, float dense) {
    context *c = test_context();
    rival_scene scene;
    model_config config;
    model *m;
    model_bank bank;
    tensor *frame;
    assert_ok(c, model_config_parse(c, preset, &config));
    rival_scene_open(c, &config, pose, RAYS, &scene);
    assert_ok(c, model_create(c, &config, 7, &m));
    rival_shake(m);
    tensor_f32(model_tensor(m, "decoder.density.bias"))[0] += dense;
    assert_ok(c, parameters_make_grads(c, m->weights));
    second s = {.scene = &scene, .own = own};
    rival_weights_take(m, &s.w);
    for (int n = 0; n < SIDE * SIDE; n++)
        if (scene.target->rays->at_box[n]) s.ray[s.rays++] = n;
    double want[RAYS][4], mix[RAYS][4];
    for (int i = 0; i < RAYS * 4; i++) (&mix[0][0])[i] = random_normal(78, (uint64_t)i);
    second_frame(&s, want);
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true, .training = true});
    assert_ok(c, model_encode(t, m, scene.body, scene.geometry, &bank));
    assert_ok(c, model_frame(t, m, scene.body, scene.geometry, &bank, scene.target, 0, 0, &frame));
    rival_frame_agrees(t, frame, s.rays, s.ray, want, mix, 1e-5);
    assert_ok(c, tape_backward_seeded(t));
    tape_free(t);
    rival_gradients_agree(m, &s.w, 2, 1e-4, second_sum, &s, mix);
    rival_weights_free(&s.w);
    model_free(m);
    rival_scene_close(&scene);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void softplus_agrees(void **state) {
    agrees("mps-nerf:own," TINY "samples=20", 0, true, 8);
}
static void another_pose_agrees(void **state) {
    agrees("mps-nerf:matched," TINY "samples=20", 1, false, 8);
}

static void counts_are_those_of_the_paper(void **state) {
    /* without the keys and queries of attention, which have no gradient with one view */
    static const rival_count known[] = {{"mps-nerf:own", 231488 + 398916 - 158720 + 679300},
                                        {"mps-nerf:matched", 1150984},
                                        {"mps-nerf:own-small", 157504 + 398916 - 158720 + 200388}};
    rival_counts(COUNT_OF(known), known);
    context *c = test_context();
    model_config k;
    assert_fails(c, model_config_parse(c, "mps-nerf:own,encoder=20", &k), SHERF_BAD_ARGUMENT,
                 "must be 18 or 34");
    sherf_context_free(c);
}

/* With jitter, each ray's depths are all moved by the same amount, up to half a step. */
static void rays_are_jittered(void **state) {
    context *c = test_context();
    model_config config;
    rival_scene s;
    sherf_observation *shown;
    target_geometry *moved;
    assert_ok(c, model_config_parse(c, "mps-nerf:own," TINY "samples=11", &config));
    rival_scene_open(c, &config, 0, 0, &s);
    rival_observation(c, 0, 1, NULL, &shown);
    const ray_draw draw = {.jitter = true, .key = 3};
    assert_ok(c, target_geometry_draw(c, &config, s.body, sherf_observation_camera(shown),
                                      sherf_observation_pose(shown), s.geometry, &draw, &moved));
    const ray_bundle *a = s.target->rays, *b = moved->rays;
    double max = 0, sum = 0;
    int count = 0;
    for (int i = 0; i < SIDE * SIDE; i++) {
        assert_int_equal(a->at_box[i], b->at_box[i]);
        if (!a->at_box[i]) continue;
        const double step = (a->far[i] - a->near[i]) / 10, by = (b->near[i] - a->near[i]) / step;
        assert_true(fabs((b->far[i] - a->far[i]) / step - by) < 1e-4);
        max = fmax(max, fabs(by));
        sum += by;
        count++;
    }
    assert_true(count > 200 && max > 0.45 && max <= 0.5001 && fabs(sum / count) < 0.05);
    target_geometry_free(moved);
    sherf_observation_free(shown);
    rival_scene_close(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- use ---- */
#define USED "mps-nerf:matched-small," TINY "samples=24"
#define USED_OWN "mps-nerf:own-small," TINY "samples=24"

static void an_avatar_shows_any_pose(void **state) {
    rival_use(USED_OWN);
    rival_moves(USED);
}
static void every_allocation_fails(void **state) {
    rival_no_memory("mps-nerf:matched-small," TINY "samples=2");
}
static void it_trains_as_its_authors_do(void **state) {
    rival_trains(USED_OWN, 60, 0.8);
}
static void it_trains_as_sherf_does(void **state) {
    rival_trains(USED, 60, 0.8);
}
static void it_is_scored_in_any_pose(void **state) {
    rival_is_scored(USED_OWN, 3);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(softplus_agrees),
                                       cmocka_unit_test(another_pose_agrees),
                                       cmocka_unit_test(counts_are_those_of_the_paper),
                                       cmocka_unit_test(rays_are_jittered),
                                       cmocka_unit_test(an_avatar_shows_any_pose),
                                       cmocka_unit_test(every_allocation_fails),
                                       cmocka_unit_test(it_trains_as_its_authors_do),
                                       cmocka_unit_test(it_trains_as_sherf_does),
                                       cmocka_unit_test(it_is_scored_in_any_pose)};
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
