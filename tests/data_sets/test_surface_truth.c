/* Tests of surface files: made from a ball with a known inside, read back, refused if damaged, and those of
 * tube people. */
#include <stdlib.h>

#include "ball.h"
#include "data/dataset.h"
#include "data/surface_truth.h"
#include "support.h"

static const float middle[3] = {0.4f, -0.2f, 1}, radius = 0.3f, cell_m = 0.01f;

/* A colour by height; the lower quarter is never seen. */
static bool by_height(void *user, const solid_point *p, bool behind, uint8_t rgb[3]) {
    int *sides = user;
    sides[behind]++;
    for (int k = 0; k < 3; k++) rgb[k] = (uint8_t)(100 + 300 * (p->position[1] - middle[1]));
    return p->position[1] > middle[1] - radius / 2;
}

/* reversed: the triangles are turned inside out. */
static void of_a_ball(context *c, bool reversed, int sides[2], surface_truth *t) {
    static ball b;
    ball_make(&b, middle, radius, 0, RINGS);
    for (int64_t i = 0; reversed && i < b.mesh.triangles; i++) {
        const uint32_t corner = b.triangle[3 * i];
        b.triangle[3 * i] = b.triangle[3 * i + 1];
        b.triangle[3 * i + 1] = corner;
    }
    sides[0] = sides[1] = 0;
    const surface_source from = {1, &b.mesh, &b.mesh, cell_m, 0, 3, by_height, sides};
    assert_ok(c, surface_truth_make(c, &from, t));
}

static double from_middle(const float x[3], double out[3]) {
    for (int k = 0; k < 3; k++) out[k] = (double)x[k] - (double)middle[k];
    return sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
}

static void a_ball(void **state) {
    context *c = test_context();
    for (int reversed = 0; reversed < 2; reversed++) {
        surface_truth t;
        int sides[2];
        of_a_ball(c, reversed, sides, &t);
        assert_true(sides[0] == 0 || sides[1] == 0);
        assert_true(t.vertices == VERTICES && t.triangles == TRIANGLES);
        /* 3/4 of a ball's height is 3/4 of its area */
        assert_true(t.places > 14000 && t.places < 16000);
        for (int64_t i = 0; i < t.places; i++) {
            double x[3];
            const double r = from_middle(t.place + 3 * i, x);
            const float *n = t.normal + 3 * i;
            const double outwards = (x[0] * (double)n[0] + x[1] * (double)n[1] + x[2] * (double)n[2]) / r;
            assert_true(r > 0.99 * (double)radius && r < 1.001 * (double)radius && outwards > 0.98);
            assert_true(x[1] > -(double)radius / 2 && abs(t.color[3 * i] - (int)(100 + 300 * x[1])) <= 1);
        }
        int near = 0, inside = 0;
        for (int64_t i = 0; i < t.points; i++) {
            double x[3];
            const double r = from_middle(t.point + 3 * i, x);
            near += fabs(r - (double)radius) < 0.1;
            inside += t.inside[i];
            if (fabs(r - (double)radius) > 2 * (double)cell_m)
                assert_int_equal(t.inside[i], r < (double)radius);
        }
        assert_true(near > 0.8 * (double)t.points && inside > 0.3 * (double)t.points);
        surface_truth_free(&t);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void nothing_to_learn_from(void **state) {
    static ball open;
    context *c = test_context();
    surface_truth t;
    int sides[2] = {0, 0};
    ball_make(&open, middle, radius, 0, RINGS / 2);
    /* walls count if half of a cell is inside; none do here */
    const surface_source from = {1, &open.mesh, &open.mesh, cell_m, 0, 3, by_height, sides};
    assert_fails(c, surface_truth_make(c, &from, &t), SHERF_BAD_ARGUMENT, "nothing is inside");
    assert_null(t.vertex);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void there_and_back(void **state) {
    context *c = test_context();
    surface_truth t, u, samples;
    int sides[2];
    of_a_ball(c, false, sides, &t);
    const char *path = test_path("ball.safetensors");
    assert_ok(c, surface_truth_write(c, &t, path));
    assert_ok(c, surface_truth_read(c, path, TRUTH_MESH | TRUTH_SAMPLES, &u));
    assert_true(u.vertices == t.vertices && u.triangles == t.triangles && u.places == t.places &&
                u.points == t.points);
    assert_memory_equal(u.vertex, t.vertex, 12 * (size_t)t.vertices);
    assert_memory_equal(u.triangle, t.triangle, 12 * (size_t)t.triangles);
    assert_memory_equal(u.place, t.place, 12 * (size_t)t.places);
    assert_memory_equal(u.normal, t.normal, 12 * (size_t)t.places);
    assert_memory_equal(u.color, t.color, 3 * (size_t)t.places);
    assert_memory_equal(u.point, t.point, 12 * (size_t)t.points);
    assert_memory_equal(u.inside, t.inside, (size_t)t.points);
    assert_ok(c, surface_truth_read(c, path, TRUTH_SAMPLES, &samples));
    assert_true(!samples.vertex && samples.places == t.places);
    surface_truth_free(&samples);
    surface_truth_free(&u);
    surface_truth_free(&t);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void damaged_files(void **state) {
    static const struct {
        const char *says;
        int what;
    } cases[] = {{"a triangle has a corner that is not there", 0},
                 {"tensor places: a value is not finite", 1},
                 {"its points are all inside", 2},
                 {"its points are all outside", 3},
                 {"inside: neither 0 nor 1", 4},
                 {"tensor normals is missing or of the wrong shape", 5}};
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        surface_truth t, u;
        int sides[2];
        of_a_ball(c, false, sides, &t);
        if (cases[i].what == 0) t.triangle[7] = (uint32_t)t.vertices;
        if (cases[i].what == 1) t.place[5] = NAN;
        if (cases[i].what == 2) memset(t.inside, 1, (size_t)t.points);
        if (cases[i].what == 3) memset(t.inside, 0, (size_t)t.points);
        if (cases[i].what == 4) t.inside[9] = 2;
        const char *path = test_path("damaged.safetensors");
        assert_ok(c, surface_truth_write(c, &t, path));
        if (cases[i].what == 5) { /* one row too few */
            const safetensor_item item[] = {{"vertices", T_F32, 2, {t.vertices, 3}, t.vertex},
                                            {"triangles", T_I32, 2, {t.triangles, 3}, t.triangle},
                                            {"places", T_F32, 2, {t.places, 3}, t.place},
                                            {"normals", T_F32, 2, {t.places - 1, 3}, t.normal}};
            assert_ok(c, safetensors_write(c, path, COUNT_OF(item), item, 0, NULL));
        }
        assert_fails(c, surface_truth_read(c, path, TRUTH_MESH | TRUTH_SAMPLES, &u), SHERF_BAD_FILE,
                     cases[i].says);
        assert_non_null(strstr(c->message, path));
        assert_true(!u.vertex && !u.inside);
        surface_truth_free(&t);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Tube people: the places are on the body, and a data set has them if requested. */
static void of_tube_people(void **state) {
    context *c = test_context();
    sherf_dataset *d;
    sherf_body *body;
    surface_truth t;
    sherf_pose pose;
    char folder[512], spec[600], file[600];
    for (int surfaces = 1; surfaces >= 0; surfaces--) {
        snprintf(folder, sizeof folder, "%s", test_path(surfaces ? "with" : "without"));
        const sherf_synth_options o = {
            .people = 1, .poses = 2, .views = 2, .size_px = 32, .seed = 4, .surfaces = surfaces};
        assert_ok(c, sherf_synth_tube(c, folder, &o));
        snprintf(spec, sizeof spec, "thuman:%s", folder);
        assert_ok(c, sherf_dataset_open(c, spec, &d));
        assert_int_equal(surface_truth_is_there(c, d, 0, 1), surfaces);
        if (!surfaces)
            assert_fails(c, surface_truth_load(c, d, 0, 1, TRUTH_SAMPLES, &t), SHERF_NO_FILE,
                         "sherf synth people --surfaces");
        if (surfaces) {
            snprintf(file, sizeof file, "%s/tubeman.safetensors", folder);
            assert_ok(c, sherf_body_load(c, file, &body));
            assert_ok(c, surface_truth_load(c, d, 0, 1, TRUTH_MESH | TRUTH_SAMPLES, &t));
            assert_ok(c, dataset_pose(c, d, 0, 1, &pose));
            float *vertex = malloc((size_t)body->vertices * 3 * sizeof *vertex);
            assert_ok(c, sherf_body_pose(c, body, &pose, vertex, NULL));
            assert_int_equal(t.vertices, body->vertices);
            for (int64_t i = 0; i < 3 * t.vertices; i++) assert_true(fabsf(t.vertex[i] - vertex[i]) < 1e-4f);
            double inside = 0;
            for (int64_t i = 0; i < t.points; i++) inside += t.inside[i];
            assert_true(inside > 0.2 * (double)t.points && inside < 0.5 * (double)t.points);
            free(vertex);
            surface_truth_free(&t);
            sherf_body_free(body);
        }
        sherf_dataset_free(d);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_ball), cmocka_unit_test(nothing_to_learn_from),
                                       cmocka_unit_test(there_and_back), cmocka_unit_test(damaged_files),
                                       cmocka_unit_test(of_tube_people)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
