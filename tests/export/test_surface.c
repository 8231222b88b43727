/* From a field to a surface: closed and manifold whatever the field, in place, oriented, without islands. */
#include <math.h>
#include <string.h>

#include "closed.h"

static double ball(const float p[3], void *user) {
    return 10 - 10 * sqrt((double)p[0] * p[0] + (double)p[1] * p[1] + (double)p[2] * p[2]) / 0.7 + 10;
}

static void ball_is_a_ball(void **state) {
    context *c = test_context();
    surface s;
    field_grid g = grid_of(c, 41, ball, NULL);
    assert_ok(c, cubes_surface(c, &g, 10, &s));
    assert_closed(&s);
    assert_int_equal(s.vertices - s.triangles / 2, 2); /* Euler's number of a sphere */
    assert_float_equal(volume_of(&s), 4 * M_PI / 3 * 0.343, 0.01);
    assert_ok(c, surface_normals(c, &s, &g));
    for (int64_t v = 0; v < s.vertices; v++) {
        const float *p = s.position + 3 * v, *n = s.normal + 3 * v;
        double r = sqrt((double)p[0] * p[0] + (double)p[1] * p[1] + (double)p[2] * p[2]);
        assert_float_equal(r, 0.7, 1e-3);
        assert_true((n[0] * p[0] + n[1] * p[1] + n[2] * p[2]) / r > 0.999);
        assert_float_equal(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1, 1e-5);
    }
    surface_free(&s);
    field_grid_free(&g);
    sherf_context_free(c);
}

static double noise(const float p[3], void *user) {
    uint64_t key = *(uint64_t *)user;
    uint64_t at = (uint64_t)lrint(((double)p[0] + 1) * 1000) * 4000000 +
                  (uint64_t)lrint(((double)p[1] + 1) * 1000) * 2000 +
                  (uint64_t)lrint(((double)p[2] + 1) * 1000);
    return random_uniform(key, at);
}

/* White noise has every case of the cube beside every other. */
static void noise_is_closed(void **state) {
    context *c = test_context();
    for (uint64_t seed = 0; seed < 4; seed++) {
        surface s;
        field_grid g = grid_of(c, 24, noise, &seed);
        assert_ok(c, cubes_surface(c, &g, 0.35f + 0.1f * (float)seed, &s));
        assert_true(s.triangles > 10000);
        assert_closed(&s);
        assert_ok(c, surface_keep_large(c, &s, 0.01, NULL));
        assert_closed(&s);
        surface_free(&s);
        field_grid_free(&g);
    }
    sherf_context_free(c);
}

/* Balls at +-0.5 along x, a small one at +0.9 along y. */
static double balls(const float p[3], void *user) {
    double a = hypot(hypot(p[0] - 0.5, p[1]), p[2]) / 0.3, b = hypot(hypot(p[0] + 0.5, p[1]), p[2]) / 0.25,
           d = hypot(hypot(p[0], p[1] - 0.8), p[2]) / 0.09;
    return 2 - fmin(a, fmin(b, d));
}

static void islands_go(void **state) {
    context *c = test_context();
    int dropped = -1;
    surface s;
    field_grid g = grid_of(c, 41, balls, NULL);
    assert_ok(c, cubes_surface(c, &g, 1, &s));
    const int64_t all = s.triangles;
    assert_ok(c, surface_keep_large(c, &s, 0.2, &dropped));
    assert_int_equal(dropped, 1);
    assert_true(s.triangles < all);
    assert_closed(&s);
    assert_float_equal(volume_of(&s), 4 * M_PI / 3 * (0.027 + 0.015625), 0.006);
    assert_ok(c, surface_keep_large(c, &s, 1, &dropped));
    assert_int_equal(dropped, 1);
    assert_closed(&s);
    assert_float_equal(volume_of(&s), 4 * M_PI / 3 * 0.027, 0.004);
    surface_free(&s);
    field_grid_free(&g);
    sherf_context_free(c);
}

/* A shell of radius 0.7 whose inside is empty, and a pinhole or not. */
static double hollow(const float p[3], void *user) {
    double r = sqrt((double)p[0] * p[0] + (double)p[1] * p[1] + (double)p[2] * p[2]);
    return r < 0.35 ? -1 : 30 - 100 * fabs(r - 0.55);
}

static void cavities_are_filled(void **state) {
    context *c = test_context();
    surface s;
    float level;
    field_grid g = grid_of(c, 49, hollow, NULL);
    for (size_t i = 0; i < 49 * 49 * 49; i++)
        if (g.value[i] < 0 && g.value[i] != -1) g.value[i] = 0;
    assert_ok(c, field_level(c, &g, &level));
    /* a column is opaque near the rim, where the density is still low */
    assert_true(level >= 1 && level < 15);
    assert_ok(c, field_solidify(c, &g, level));
    assert_ok(c, cubes_surface(c, &g, level, &s));
    assert_closed(&s);
    assert_int_equal(s.vertices - s.triangles / 2, 2); /* one sphere, none inside */
    double r = cbrt(volume_of(&s) * 3 / (4 * M_PI));
    assert_true(r > 0.75 && r < 0.87);
    surface_free(&s);
    field_grid_free(&g);
    sherf_context_free(c);
}

static void emptiness_is_said(void **state) {
    context *c = test_context();
    float level;
    uint64_t key = 3;
    field_grid g = grid_of(c, 20, noise, &key);
    for (size_t i = 0; i < 8000; i++) g.value[i] *= 0.1f;
    assert_int_equal(field_level(c, &g, &level), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "nowhere opaque"));
    field_grid_free(&g);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(ball_is_a_ball), cmocka_unit_test(noise_is_closed),
                                       cmocka_unit_test(islands_go), cmocka_unit_test(cavities_are_filled),
                                       cmocka_unit_test(emptiness_is_said)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
