/* Tests of frames with a coarse field: their difference from frames that query every point, and the
 * correction of samples that were not queried. */
#include <math.h>
#include <string.h>

#include "avatar/avatar.h"
#include "support.h"

static const char model_path[] = "../assets/models/people.safetensors",
                  body_path[] = "../assets/body.safetensors";

typedef struct {
    context *c;
    sherf_body *body;
    sherf_observation *observation;
    sherf_avatar *avatar;
} scene;

static void open_scene(int threads, sherf_precision precision, scene *s) {
    const sherf_options options = {.threads = threads, .precision = precision};
    sherf_model *m;
    assert_int_equal(sherf_context_create(&options, &s->c), SHERF_OK);
    assert_ok(s->c, sherf_body_load(s->c, body_path, &s->body));
    assert_ok(s->c, sherf_model_load(s->c, model_path, &m));
    assert_ok(s->c, sherf_observation_load(s->c, "thuman:../assets/demo#person_900006/0/0", &s->observation));
    assert_ok(s->c, sherf_avatar_create(s->c, m, s->body, s->observation, &s->avatar));
    sherf_model_free(m);
}

static void close_scene(scene *s) {
    sherf_avatar_free(s->avatar);
    sherf_observation_free(s->observation);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
}

/* The middle of the picture, `larger` times as large, so many pixels wide. */
static void render(const scene *s, int side, float larger, int exact, sherf_frame *frame) {
    const sherf_render_options o = {.exact = exact, .detail = SHERF_DETAIL_OFF};
    sherf_camera k = *sherf_observation_camera(s->observation);
    camera_resize(&k, side, side);
    for (int i = 0; i < 2; i++) {
        k.K[4 * i] *= larger;
        k.K[3 * i + 2] = (float)side / 2 + (k.K[3 * i + 2] - (float)side / 2) * larger;
    }
    assert_ok(s->c,
              sherf_render(s->c, s->avatar, s->body, sherf_observation_pose(s->observation), &k, &o, frame));
}

static double psnr(const sherf_frame *a, const sherf_frame *b, double *worst) {
    const size_t n = 3 * (size_t)a->color.width * (size_t)a->color.height;
    double sum = 0;
    *worst = 0;
    for (size_t i = 0; i < n; i++) {
        const double d = fabs((double)a->color.data[i] - b->color.data[i]);
        sum += d * d;
        *worst = fmax(*worst, d);
    }
    return -10 * log10(sum / (double)n);
}

/* How far a frame may be from one that queries every point. */
typedef struct {
    float larger, min_db, worst;
    int share; /* the maximum of queried points: one in this many */
} closeness;

static void check_closeness(sherf_precision precision, int count, const closeness cases[]) {
    scene s;
    open_scene(2, precision, &s);
    if (s.c->precision != precision) { /* no AMX */
        close_scene(&s);
        skip();
    }
    for (int i = 0; i < count; i++) {
        sherf_frame exact = {0}, coarse = {0};
        double worst;
        render(&s, 224, cases[i].larger, 1, &exact);
        render(&s, 224, cases[i].larger, 0, &coarse);
        const double db = psnr(&exact, &coarse, &worst);
        print_message("larger by %g: %.1f dB, at most %.3f apart\n", (double)cases[i].larger, db, worst);
        if (!(db > cases[i].min_db && worst < cases[i].worst))
            fail_msg("%d: %.1f dB, at most %.3f apart", i, db, worst);
        if (!(coarse.points > 0 && coarse.points * cases[i].share < exact.points))
            fail_msg("%d: %lld of %lld points", i, (long long)coarse.points, (long long)exact.points);
        sherf_frame_free(&exact);
        sherf_frame_free(&coarse);
    }
    close_scene(&s);
}

/* Pixels about 3 and 8 mm apart: with and without the chequerboard. */
static void frames_are_close(void **state) {
    static const closeness cases[] = {{3, 45, 0.4f, 5}, {1, 54, 0.15f, 2}};
    check_closeness(SHERF_PRECISION_FP32, COUNT_OF(cases), cases);
}

/* In bf16, which takes AMX, there is no chequerboard. */
static void frames_in_bf16_are_closer(void **state) {
    static const closeness cases[] = {{3, 46, 0.3f, 4}};
    check_closeness(SHERF_PRECISION_BF16, COUNT_OF(cases), cases);
}

/* If a picture has hardly more points than the field has cells, only empty space is skipped. */
static void small_pictures_do_without(void **state) {
    scene s;
    double worst;
    sherf_frame exact = {0}, plain = {0};
    open_scene(2, SHERF_PRECISION_FP32, &s);
    render(&s, 64, 1, 1, &exact);
    render(&s, 64, 1, 0, &plain);
    assert_true(s.avatar->occupancy->coarse.value && s.avatar->occupancy->cells.bit);
    assert_true(plain.points < exact.points && plain.points > exact.points / 4);
    assert_true(psnr(&exact, &plain, &worst) > 60);
    sherf_frame_free(&exact);
    sherf_frame_free(&plain);
    close_scene(&s);
}

static void threads_do_not_matter(void **state) {
    sherf_frame frame[2] = {0};
    for (int i = 0; i < 2; i++) {
        scene s;
        open_scene(i + 1, SHERF_PRECISION_FP32, &s);
        render(&s, 96, 3, 0, &frame[i]);
        close_scene(&s);
    }
    assert_memory_equal(frame[0].color.data, frame[1].color.data, 3 * 96 * 96 * sizeof(float));
    assert_memory_equal(frame[0].depth.data, frame[1].depth.data, 96 * 96 * sizeof(float));
    for (int i = 0; i < 2; i++) sherf_frame_free(&frame[i]);
}

/* Between cell centres the field is linear in each direction; beyond the outermost ones it is constant. */
static void the_field_is_trilinear(void **state) {
    enum { X = 4, Y = 3, Z = 2 };
    _Alignas(16) float value[Z * Y * X][4], out[4];
    const coarse_field f = {.cells = {X, Y, Z}, .min = {-1, 2, 0.5f}, .per_m = 10, .value = value};
    for (int i = 0; i < X * Y * Z; i++)
        for (int k = 0; k < 4; k++)
            value[i][k] =
                (float)(k + 1) * ((float)(i % X) + 10 * (float)(i / X % Y) + 100 * (float)(i / X / Y));
    for (int i = 0; i < 200; i++) {
        float at[3], cell[3];
        for (int k = 0; k < 3; k++) {
            const float v = 1.4f * (float)random_uniform(7, (uint64_t)(3 * i + k)) - 0.2f;
            at[k] = f.min[k] + v * (float)f.cells[k] / f.per_m;
            cell[k] = fminf(fmaxf(v * (float)f.cells[k] - 0.5f, 0), (float)(f.cells[k] - 1));
        }
        coarse_at(&f, at, out);
        for (int k = 0; k < 4; k++)
            assert_float_equal(out[k], (float)(k + 1) * (cell[0] + 10 * cell[1] + 100 * cell[2]), 2e-3f);
    }
}

/* Five rays in a cross. The middle ray's sample moves like its neighbours beside, in front and behind. It
 * stays if none of them was queried, and so do samples of small weight. */
static void samples_move_with_their_neighbours(void **state) {
    enum { RAYS = 9, P = 11 };
    context *c;
    assert_int_equal(sherf_context_create(&(sherf_options){.threads = 1}, &c), SHERF_OK);
    float direction[3 * RAYS], near[RAYS], far[RAYS];
    for (int n = 0; n < RAYS; n++) {
        near[n] = 2;
        far[n] = 2.9f;
        for (int k = 0; k < 3; k++) direction[3 * n + k] = k == 2 ? 1 : 0.05f * (float)(k ? n / 3 : n % 3);
    }
    const ray_bundle rays = {.width = 3, .height = 3, .direction = direction, .near = near, .far = far};
    /* rays 1, 3, 5 and 7 have sample 4; the middle ray has 3, 4, 5 and 8; ray 0 has 4 but is not beside it */
    int32_t first[RAYS + 1] = {0, 1, 2, 2, 3, 7, 8, 8, 9, 11}, sample[P] = {4, 4, 4, 3, 4, 5, 8, 4, 4, 1, 2};
    int32_t at[P] = {0, 1, 2, 3, COARSE_MOVED, 4, COARSE_MOVED, 5, COARSE_KEPT, 6, COARSE_KEPT};
    float rgb[3 * P] = {0}, sigma[P] = {0}, new_rgb[21] = {0}, new_sigma[7] = {100, 1, 2, 30, 40, 3, 50};
    for (int i = 0; i < 7; i++) new_rgb[3 * i] = new_sigma[i] / 100;
    for (int i = 0; i < P; i++) sigma[i] = 10;
    point_set queried = {.count = 7};
    coarse_points p = {.queried = &queried,
                       .all = {.count = P, .rays = RAYS, .samples = 10, .first = first, .sample = sample},
                       .rgb = rgb,
                       .sigma = sigma,
                       .queried_at = at};
    assert_ok(c, coarse_points_answer(c, &rays, new_rgb, new_sigma, &p));
    assert_true(sigma[0] == 100 && sigma[3] == 30 && sigma[5] == 40 && rgb[9] == 0.3f);
    assert_true(sigma[8] == 10 && sigma[10] == 10 && rgb[30] == 0); /* small weight */
    assert_true(sigma[6] == 10);                                    /* no neighbour was queried */
    /* pixels and samples are a decimetre apart: three beside (-9, -8, -7), before and behind (20, 30) */
    assert_float_equal(sigma[4], 10 + (-9 - 8 - 7 + 20 + 30) / 5.0f, 1e-2f);
    assert_float_equal(rgb[12], (0.01f + 0.02f + 0.03f + 0.3f + 0.4f) / 5, 1e-3f);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(frames_are_close),          cmocka_unit_test(frames_in_bf16_are_closer),
        cmocka_unit_test(small_pictures_do_without), cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(the_field_is_trilinear),    cmocka_unit_test(samples_move_with_their_neighbours)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
