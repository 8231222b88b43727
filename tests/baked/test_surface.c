/* Tests of the surface made from a density field: it is closed and manifold for any field, in place, oriented
 * and free of islands. */
#include <math.h>
#include <string.h>

#include "closed.h"
#include "baked/atlas.h"
#include "baked/texels.h"
#include "baked/splats.h"

static double ball(const float p[3], void *user) {
    return 10 - 10 * sqrt((double)p[0] * p[0] + (double)p[1] * p[1] + (double)p[2] * p[2]) / 0.7 + 10;
}

static void ball_is_a_ball(void **state) {
    context *c = test_context();
    surface s;
    cubes_grid g = grid_of(c, 41, ball, NULL);
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
    cubes_grid_free(&g);
    sherf_context_free(c);
}

static double noise(const float p[3], void *user) {
    uint64_t key = *(uint64_t *)user;
    uint64_t at = (uint64_t)lrint(((double)p[0] + 1) * 1000) * 4000000 +
                  (uint64_t)lrint(((double)p[1] + 1) * 1000) * 2000 +
                  (uint64_t)lrint(((double)p[2] + 1) * 1000);
    return random_uniform(key, at);
}

/* In white noise every case of the cube occurs next to every other. */
static void noise_is_closed(void **state) {
    context *c = test_context();
    for (uint64_t seed = 0; seed < 4; seed++) {
        surface s;
        cubes_grid g = grid_of(c, 24, noise, &seed);
        assert_ok(c, cubes_surface(c, &g, 0.35f + 0.1f * (float)seed, &s));
        assert_true(s.triangles > 10000);
        assert_closed(&s);
        assert_ok(c, surface_keep_large(c, &s, 0.01, NULL));
        assert_closed(&s);
        surface_free(&s);
        cubes_grid_free(&g);
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
    cubes_grid g = grid_of(c, 41, balls, NULL);
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
    cubes_grid_free(&g);
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
    cubes_grid g = grid_of(c, 49, hollow, NULL);
    for (size_t i = 0; i < 49 * 49 * 49; i++)
        if (g.value[i] < 0 && g.value[i] != -1) g.value[i] = 0;
    assert_ok(c, field_level(c, &g, &level));
    /* near the rim a column is opaque although the density is still low */
    assert_true(level >= 1 && level < 15);
    assert_ok(c, field_solidify(c, &g, level));
    assert_ok(c, cubes_surface(c, &g, level, &s));
    assert_closed(&s);
    assert_int_equal(s.vertices - s.triangles / 2, 2); /* one sphere, none inside */
    double r = cbrt(volume_of(&s) * 3 / (4 * M_PI));
    assert_true(r > 0.75 && r < 0.87);
    surface_free(&s);
    cubes_grid_free(&g);
    sherf_context_free(c);
}

/* A soft ball of radius 9 cm and a soft rod of 1.2 cm along y, in a box of 40 cm. */
static const double ball_x_m = -0.08, rod_x_m = 0.13;
static double soft(double beyond_m) {
    return 80 * exp(-fmax(0, beyond_m) / 0.006);
}
static double ball_and_rod(const float p[3], void *user) {
    const double x = 0.2 * p[0], y = 0.2 * p[1], z = 0.2 * p[2];
    double from_ball = hypot(hypot(x - ball_x_m, y), z) - 0.09, from_rod = hypot(x - rod_x_m, z) - 0.012;
    return soft(fmin(from_ball, from_rod + fmax(0, fabs(y) - 0.12)));
}

/* The distance from the axis of a ray that is as opaque as outlines are. */
static double outline_of(double radius_m) {
    for (double off = 0.2; off > 0; off -= 1e-4) {
        double depth = 0;
        for (double t = -0.2; t < 0.2; t += 1e-3) depth += 1e-3 * soft(hypot(off, t) - radius_m);
        if (1 - exp(-depth) >= 0.75) return off;
    }
    return 0;
}

/* Mean distances of the surface from the ball's centre and the rod's axis. */
static void radii_of(const surface *s, double *ball_m, double *rod_m) {
    double sum[2] = {0, 0};
    int64_t count[2] = {0, 0};
    for (int64_t v = 0; v < s->vertices; v++) {
        const float *p = s->position + 3 * v;
        const bool rod = p[0] > 0.07;
        if (rod && fabsf(p[1]) > 0.08f) continue;
        sum[rod] += rod ? hypot(p[0] - rod_x_m, p[2]) : hypot(hypot(p[0] - ball_x_m, p[1]), p[2]);
        count[rod]++;
    }
    assert_true(count[0] > 100 && count[1] > 20);
    *ball_m = sum[0] / (double)count[0];
    *rod_m = sum[1] / (double)count[1];
}

/* Outlines of thick and thin parts are where rays are equally opaque, which a single level cannot achieve. */
static void thick_and_thin_have_their_outlines(void **state) {
    context *c = test_context();
    double radius[2][2];
    float level;
    for (int places = 0; places < 2; places++) {
        surface s;
        cubes_grid g = grid_of(c, 81, ball_and_rod, NULL);
        for (int k = 0; k < 3; k++) g.min[k] *= 0.2f;
        g.step_m *= 0.2f;
        assert_ok(c, field_level(c, &g, &level));
        if (places) assert_ok(c, field_level_places(c, &g, level));
        assert_ok(c, field_solidify(c, &g, level));
        assert_ok(c, cubes_surface(c, &g, level, &s));
        assert_closed(&s);
        radii_of(&s, &radius[places][0], &radius[places][1]);
        surface_free(&s);
        cubes_grid_free(&g);
    }
    assert_float_equal(radius[1][0], outline_of(0.09), 0.001);
    assert_float_equal(radius[1][1], outline_of(0.012), 0.002);
    assert_true(fabs(radius[0][1] - outline_of(0.012)) > 0.0035);
    sherf_context_free(c);
}

static void emptiness_is_said(void **state) {
    context *c = test_context();
    float level;
    uint64_t key = 3;
    cubes_grid g = grid_of(c, 20, noise, &key);
    for (size_t i = 0; i < 8000; i++) g.value[i] *= 0.1f;
    assert_int_equal(field_level(c, &g, &level), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "nowhere opaque"));
    cubes_grid_free(&g);
    sherf_context_free(c);
}

/* ---- fewer triangles ---- */
static void reduction_keeps_the_surface(void **state) {
    context *c = test_context();
    surface s;
    cubes_grid g = grid_of(c, 49, balls, NULL);
    assert_ok(c, cubes_surface(c, &g, 1, &s));
    const double volume = volume_of(&s);
    assert_ok(c, surface_reduce(c, &s, s.triangles));
    for (int64_t wanted = s.triangles / 2; wanted > 700; wanted /= 2) {
        assert_ok(c, surface_reduce(c, &s, wanted));
        assert_closed(&s);
        assert_true(s.triangles <= wanted && s.triangles > wanted - 4);
        assert_float_equal(volume_of(&s), volume, 0.02 * volume);
    }
    /* three balls cannot have fewer */
    assert_ok(c, surface_reduce(c, &s, 1));
    assert_closed(&s);
    assert_true(s.triangles >= 12 && s.triangles < 120);
    surface_free(&s);
    cubes_grid_free(&g);
    sherf_context_free(c);
}

static void noise_is_reduced(void **state) {
    context *c = test_context();
    surface s;
    uint64_t key = 7;
    cubes_grid g = grid_of(c, 20, noise, &key);
    assert_ok(c, cubes_surface(c, &g, 0.6f, &s));
    const int64_t before = s.triangles;
    assert_ok(c, surface_reduce(c, &s, before / 3));
    assert_true(s.triangles < before / 2);
    assert_closed(&s);
    surface_free(&s);
    cubes_grid_free(&g);
    sherf_context_free(c);
}

/* ---- the atlas ---- */
/* The corners of a texel's triangle and its place in the triangle must match its place in the picture. */
static void assert_texels(const surface *s, const atlas *a) {
    uint8_t *taken = calloc((size_t)a->side_px * (size_t)a->side_px, 1);
    assert_true(a->texels > 0);
    for (int64_t i = 0; i < a->texels; i++) {
        const uint32_t *t = a->triangle + 3 * (size_t)a->face[i];
        const float b1 = a->barycentric[2 * i], b2 = a->barycentric[2 * i + 1];
        for (int k = 0; k < 2; k++) {
            float at =
                (1 - b1 - b2) * a->uv[2 * t[0] + k] + b1 * a->uv[2 * t[1] + k] + b2 * a->uv[2 * t[2] + k];
            int own = k ? a->texel[i] / a->side_px : a->texel[i] % a->side_px;
            assert_float_equal(at, own, 0.02);
        }
        assert_false(taken[a->texel[i]]++);
    }
    for (int64_t i = 0; i < 3 * s->triangles; i++) {
        assert_true(a->triangle[i] < a->corners);
        assert_int_equal(a->vertex[a->triangle[i]], s->triangle[i]);
    }
    for (int64_t i = 0; i < 2 * a->corners; i++) assert_true(a->uv[i] >= 1 && a->uv[i] <= a->side_px - 2);
    free(taken);
}

/* Triangles may share borders, not insides: the areas in the picture are those of its texels. */
static void assert_apart(const surface *s, const atlas *a, double slack) {
    double area = 0;
    for (int64_t t = 0; t < s->triangles; t++) {
        const float *p = a->uv + 2 * a->triangle[3 * t], *q = a->uv + 2 * a->triangle[3 * t + 1],
                    *r = a->uv + 2 * a->triangle[3 * t + 2];
        area += fabs((double)(q[0] - p[0]) * (r[1] - p[1]) - (double)(q[1] - p[1]) * (r[0] - p[0])) / 2;
    }
    assert_float_equal(area, (double)a->texels, slack * area);
}

/* Texels' places can be restored from every other texel's, within a fraction of a texel's side, even next to
 * another chart. */
static void assert_spread(context *c, const surface *s, const atlas *a, double sides_max) {
    float *place = malloc((size_t)a->texels * 3 * sizeof *place),
          *some = malloc((size_t)a->texels * 3 * sizeof *some),
          *all = malloc((size_t)a->texels * 3 * sizeof *all);
    texel_mesh mesh;
    double side = 0, worst = 0;
    int64_t pairs = 0;
    for (int64_t i = 0; i < a->texels; i++) {
        const uint32_t *t = s->triangle + 3 * (size_t)a->face[i];
        const float b1 = a->barycentric[2 * i], b2 = a->barycentric[2 * i + 1];
        for (size_t k = 0; k < 3; k++)
            place[3 * (size_t)i + k] = (1 - b1 - b2) * s->position[3 * (size_t)t[0] + k] +
                                       b1 * s->position[3 * (size_t)t[1] + k] +
                                       b2 * s->position[3 * (size_t)t[2] + k];
    }
    for (int64_t i = 0; i + 1 < a->texels; i++)
        if (a->texel[i + 1] == a->texel[i] + 1 && a->face[i] == a->face[i + 1]) {
            double sum = 0;
            for (int k = 0; k < 3; k++) sum += pow((double)place[3 * i + 3 + k] - place[3 * i + k], 2);
            side += sqrt(sum);
            pairs++;
        }
    assert_ok(c, texel_mesh_make(c, a, place, &mesh));
    assert_true((double)mesh.count < 0.45 * (double)a->texels);
    for (int64_t i = 0; i < mesh.count; i++)
        memcpy(some + 3 * i, place + 3 * (size_t)mesh.texel[i], 3 * sizeof *some);
    texel_mesh_spread(a, &mesh, some, all);
    for (int64_t i = 0; i < 3 * a->texels; i++) worst = fmax(worst, fabs((double)all[i] - place[i]));
    if (!(worst < sides_max * side / (double)pairs))
        fail_msg("%g of a texel's side apart, %g of the texels", worst * (double)pairs / side,
                 (double)mesh.count / (double)a->texels);
    texel_mesh_free(&mesh);
    free(place), free(some), free(all);
}

static void atlas_is_an_atlas(void **state) {
    context *c = test_context();
    surface s;
    atlas a;
    cubes_grid g = grid_of(c, 41, ball, NULL);
    assert_ok(c, cubes_surface(c, &g, 10, &s));
    assert_ok(c, surface_normals(c, &s, &g));
    assert_ok(c, atlas_make(c, &s, 256, &a));
    assert_true(a.charts >= 4 && a.charts < 40);
    assert_texels(&s, &a);
    assert_apart(&s, &a, 0.05);
    assert_true((double)a.texels > 0.35 * 256 * 256); /* the atlas fills the picture */
    assert_spread(c, &s, &a, 0.5);
    float *rgb = malloc((size_t)a.texels * 3 * sizeof *rgb);
    uint8_t *picture = malloc(256 * 256 * 3);
    for (int64_t i = 0; i < 3 * a.texels; i++) rgb[i] = i % 3 ? 0.25f : 1;
    assert_ok(c, atlas_paint(c, &a, rgb, picture));
    for (int i = 0; i < 256 * 256; i++) { /* one colour everywhere, gutters too */
        assert_int_equal(picture[3 * i], 255);
        assert_int_equal(picture[3 * i + 1], 64);
    }
    free(rgb), free(picture);
    atlas_free(&a);
    surface_free(&s);
    cubes_grid_free(&g);
    sherf_context_free(c);
}

/* A surface more folded and torn than any person. */
static void atlas_of_noise(void **state) {
    context *c = test_context();
    surface s;
    atlas a;
    uint64_t key = 9;
    cubes_grid g = grid_of(c, 14, noise, &key);
    assert_ok(c, cubes_surface(c, &g, 0.55f, &s));
    assert_ok(c, surface_normals(c, &s, &g));
    assert_ok(c, atlas_make(c, &s, 1024, &a));
    assert_texels(&s, &a);
    assert_apart(&s, &a, 0.1);
    assert_spread(c, &s, &a, 4.3);
    atlas_free(&a);
    assert_int_equal(atlas_make(c, &s, 64, &a), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "too small"));
    assert_int_equal(atlas_make(c, &s, 1 << 20, &a), SHERF_BAD_ARGUMENT);
    surface_free(&s);
    cubes_grid_free(&g);
    sherf_context_free(c);
}

/* ---- splats ---- */
static void splats_cover_evenly(void **state) {
    enum { COUNT = 2000 };
    context *c = test_context();
    surface s;
    splats p;
    cubes_grid g = grid_of(c, 41, ball, NULL);
    assert_ok(c, cubes_surface(c, &g, 10, &s));
    assert_ok(c, surface_normals(c, &s, &g));
    assert_ok(c, splats_make(c, &s, COUNT, &p));
    assert_int_equal(p.count, COUNT);
    splats_place(&s, s.position, s.normal, &p);
    const double spacing = sqrt(4 * M_PI * 0.49 / COUNT);
    double nearest = INFINITY, farthest = 0;
    for (int i = 0; i < COUNT; i++) { /* no two coincide, and there are no holes */
        const float *a = p.position + 3 * i;
        double own = INFINITY;
        assert_float_equal(sqrt((double)a[0] * a[0] + (double)a[1] * a[1] + (double)a[2] * a[2]), 0.7, 0.003);
        for (int j = 0; j < COUNT; j++) {
            const float *b = p.position + 3 * j;
            double d = hypot(hypot((double)a[0] - b[0], (double)a[1] - b[1]), (double)a[2] - b[2]);
            if (j != i) own = fmin(own, d);
        }
        nearest = fmin(nearest, own);
        farthest = fmax(farthest, own);
        float q[4], z[3];
        splat_rotation(p.normal + 3 * i, q);
        z[0] = 2 * (q[1] * q[3] + q[0] * q[2]); /* the direction to which the rotation takes z */
        z[1] = 2 * (q[2] * q[3] - q[0] * q[1]);
        z[2] = 1 - 2 * (q[1] * q[1] + q[2] * q[2]);
        for (int k = 0; k < 3; k++) assert_float_equal(z[k], p.normal[3 * i + k], 1e-4);
    }
    assert_true(nearest > 0.4 * spacing && farthest < 1.6 * spacing);
    float q[4];
    splat_rotation((float[3]){0, 0, -1}, q);
    assert_float_equal(1 - 2 * (q[1] * q[1] + q[2] * q[2]), -1, 1e-5);
    splats_free(&p);
    assert_int_equal(splats_make(c, &s, 0, &p), SHERF_BAD_ARGUMENT);
    surface_free(&s);
    cubes_grid_free(&g);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(ball_is_a_ball),
                                       cmocka_unit_test(noise_is_closed),
                                       cmocka_unit_test(islands_go),
                                       cmocka_unit_test(cavities_are_filled),
                                       cmocka_unit_test(thick_and_thin_have_their_outlines),
                                       cmocka_unit_test(emptiness_is_said),
                                       cmocka_unit_test(reduction_keeps_the_surface),
                                       cmocka_unit_test(noise_is_reduced),
                                       cmocka_unit_test(atlas_is_an_atlas),
                                       cmocka_unit_test(atlas_of_noise),
                                       cmocka_unit_test(splats_cover_evenly)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
