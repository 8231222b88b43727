/* Tests of surface distances against known ones. */
#include <stdlib.h>

#include "baked/form.h"
#include "ball.h"
#include "data/surface_truth.h"
#include "eval/surface_list.h"
#include "support.h"

/* A ball inside a larger one: 1 cm everywhere, with the same normals. */
static void a_ball_in_a_ball(void **state) {
    static ball small, large;
    context *c = test_context();
    surface_scores s;
    const float middle[3] = {0.3f, 0, -2};
    ball_make(&small, middle, 0.19f, 0, RINGS);
    ball_make(&large, middle, 0.2f, 0, RINGS);
    assert_ok(c, surfaces_compare(c, 2000, 3, 0.005f, 1, &small.mesh, 1, &large.mesh, &s));
    assert_true(fabs(s.to_truth_m - 0.01) < 2e-4 && fabs(s.from_truth_m - 0.01) < 2e-4);
    assert_true(fabs(s.chamfer_m - (s.to_truth_m + s.from_truth_m) / 2) < 1e-12 && s.normal_deg < 3);
    assert_ok(c, surfaces_compare(c, 500, 3, 0.005f, 1, &small.mesh, 1, &small.mesh, &s));
    assert_true(s.chamfer_m < 1e-7 && s.normal_deg < 0.1);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Half of the truth: all of it lies on the truth, but the other half of the truth is far from it. */
static void half_a_ball(void **state) {
    static ball half, all;
    context *c = test_context();
    surface_scores s;
    const float middle[3] = {0, 0, 0};
    ball_make(&half, middle, 0.2f, 0, RINGS / 2);
    ball_make(&all, middle, 0.2f, 0, RINGS);
    assert_ok(c, surfaces_compare(c, 4000, 4, 0.01f, 1, &half.mesh, 1, &all.mesh, &s));
    assert_true(s.to_truth_m < 1e-7);
    /* from angle a below the rim to the rim it is 2 r sin(a / 2), averaged over half of the ball's area */
    const double mean = 4 * 0.2 * (sqrt(2) - 1) / 3;
    assert_true(fabs(s.from_truth_m - mean / 2) < 0.002);
    sherf_context_free(c);
}

/* The truth is a ball; so are predictions: the same one, one of half the radius, and one beside it. */
static void insides_overlap(void **state) {
    enum { POINTS = 20000 };
    static ball b;
    static float point[3 * POINTS];
    static uint8_t inside[POINTS];
    context *c = test_context();
    double same, half, apart;
    for (uint64_t i = 0; i < POINTS; i++) {
        float *p = point + 3 * i;
        for (uint64_t k = 0; k < 3; k++) p[k] = (float)(0.6 * random_uniform(7, 3 * i + k) - 0.3);
        inside[i] = p[0] * p[0] + p[1] * p[1] + p[2] * p[2] < 0.04f;
    }
    ball_make(&b, (float[]){0, 0, 0}, 0.2f, 0, RINGS);
    assert_ok(c, surfaces_overlap(c, 0.004f, 1, &b.mesh, POINTS, point, inside, &same));
    ball_make(&b, (float[]){0, 0, 0}, 0.1f, 0, RINGS);
    assert_ok(c, surfaces_overlap(c, 0.004f, 1, &b.mesh, POINTS, point, inside, &half));
    ball_make(&b, (float[]){0.5f, 0, 0}, 0.2f, 0, RINGS);
    assert_ok(c, surfaces_overlap(c, 0.004f, 1, &b.mesh, POINTS, point, inside, &apart));
    assert_true(same > 0.97 && fabs(half - 0.125) < 0.015 && apart == 0);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* The exact distance for every kind of place: above the face, at an edge, at a corner. */
static void places_by_a_triangle(void **state) {
    static ball tiny;
    context *c = test_context();
    float v[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint32_t t[3] = {0, 1, 2};
    const solid_mesh mesh = {3, 1, v, t};
    static const struct {
        float at[3];
        double distance;
    } some[] = {{{0.2f, 0.2f, 0.5f}, 0.5},
                {{0.5f, -0.3f, 0.4f}, 0.5},
                {{-0.3f, -0.4f, 0}, 0.5},
                {{1, 1, 0}, 0.70710678}};
    for (size_t i = 0; i < COUNT_OF(some); i++) {
        surface_scores s;
        ball_make(&tiny, some[i].at, 0.001f, 0, RINGS);
        assert_ok(c, surfaces_compare(c, 400, 5, 0.05f, 1, &tiny.mesh, 1, &mesh, &s));
        assert_true(fabs(s.to_truth_m - some[i].distance) < 2e-4);
    }
    sherf_context_free(c);
}

static void mistakes_are_one_line(void **state) {
    static ball b;
    context *c = test_context();
    surface_scores s;
    ball_make(&b, (float[]){0, 0, 0}, 0.2f, 0, RINGS);
    const solid_mesh none = {0};
    assert_fails(c, surfaces_compare(c, 10, 1, 0.01f, 1, &none, 1, &b.mesh, &s), SHERF_BAD_ARGUMENT,
                 "no triangles");
    assert_fails(c, surfaces_compare(c, 0, 1, 0.01f, 1, &b.mesh, 1, &b.mesh, &s), SHERF_BAD_ARGUMENT,
                 "one place");
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static solid_mesh mesh_of(const void *field) {
    return *(const solid_mesh *)field;
}

/* A baked avatar's surface is compared in the observed pose: here it is the truth at rest, moved by the root.
 */
static void assert_baked_one_is_compared(context *c, const sherf_dataset *d, const char *folder,
                                         const surface_truth *t) {
    const size_t n = (size_t)t->vertices;
    body_model *body;
    char path[600];
    snprintf(path, sizeof path, "%s/tubeman.safetensors", folder);
    assert_ok(c, sherf_body_load(c, path, &body));
    baked_form form = {.corners = t->vertices,
                       .triangles = t->triangles,
                       .rest = t->vertex,
                       .triangle = t->triangle,
                       .joint = calloc(n, 4),
                       .weight = calloc(n, 4 * sizeof(float))};
    for (size_t i = 0; i < n; i++) form.weight[4 * i] = 1;
    sherf_avatar avatar = {.form = &baked_avatar_form, .formed = &form};
    sherf_pose_identity(&avatar.picture[0].pose);
    surface_list l = {0};
    assert_ok(c, surface_list_measure(c, &l, d, body, &avatar, 1, (picture){0, 1}));
    assert_true(l.count == 1 && l.entry[0].scores.chamfer_m < 1e-6);
    avatar.picture[0].pose.Th_m[1] = 0.5f; /* half a metre higher */
    assert_ok(c, surface_list_measure(c, &l, d, body, &avatar, 1, (picture){0, 1}));
    assert_true(l.count == 2 && l.entry[1].scores.chamfer_m > 0.05);
    surface_list_free(&l);
    free(form.joint);
    free(form.weight);
    sherf_body_free(body);
}

/* An avatar with the data set's surface has distance 0; moved by one centimetre, at most one. */
static void avatars_and_the_data_sets_surface(void **state) {
    static const field_kind known = {.surface = mesh_of};
    context *c = test_context();
    sherf_dataset *d;
    surface_truth t;
    surface_list l = {0};
    int64_t n;
    char folder[512], spec[600];
    snprintf(folder, sizeof folder, "%s", test_path("people"));
    const sherf_synth_options o = {.people = 2, .poses = 1, .views = 2, .size_px = 32, .surfaces = 1};
    assert_ok(c, sherf_synth_tube(c, folder, &o));
    snprintf(spec, sizeof spec, "thuman:%s", folder);
    assert_ok(c, sherf_dataset_open(c, spec, &d));
    assert_ok(c, surface_truth_load(c, d, 1, 0, TRUTH_MESH, &t));
    solid_mesh mesh = {t.vertices, t.triangles, t.vertex, t.triangle};
    const sherf_avatar with = {.field_kind = &known, .field = &mesh}, without = {.field_kind = &field_of_ops};
    const picture seen = {0, 1};
    assert_baked_one_is_compared(c, d, folder, &t);
    assert_ok(c, surface_list_measure(c, &l, d, NULL, &without, 1, seen));
    assert_int_equal(l.count + l.missed, 0);
    assert_ok(c, surface_list_measure(c, &l, d, NULL, &with, 1, seen));
    assert_true(l.count == 1 && l.entry[0].scores.chamfer_m < 1e-6 &&
                l.entry[0].scores.overlap < 0.01); /* tubes are open */
    for (int64_t i = 0; i < t.vertices; i++) t.vertex[3 * i] += 0.01f;
    assert_ok(c, surface_list_measure(c, &l, d, NULL, &with, 1, seen));
    const surface_scores *s = &l.entry[1].scores;
    assert_true(s->to_truth_m > 0.003 && s->to_truth_m < 0.01 && s->from_truth_m > 0.003 &&
                s->from_truth_m < 0.01);
    assert_true(fabs(surface_list_mean(&l, 1, &n).chamfer_m -
                     (l.entry[0].scores.chamfer_m + s->chamfer_m) / 2) < 1e-12 &&
                n == 2);
    surface_list_mean(&l, 0, &n);
    assert_int_equal(n, 0);
    mesh.triangles = 1; /* no surface was made */
    assert_ok(c, surface_list_measure(c, &l, d, NULL, &with, 1, seen));
    assert_true(l.count == 2 && l.missed == 1);
    char *text = surface_list_text(c, &l);
    assert_non_null(strstr(text, "surfaces of 2 observations: Chamfer 0."));
    mem_free(text);
    surface_list_free(&l);
    surface_truth_free(&t);
    sherf_dataset_free(d);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(avatars_and_the_data_sets_surface),
                                       cmocka_unit_test(a_ball_in_a_ball),
                                       cmocka_unit_test(half_a_ball),
                                       cmocka_unit_test(insides_overlap),
                                       cmocka_unit_test(places_by_a_triangle),
                                       cmocka_unit_test(mistakes_are_one_line)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
