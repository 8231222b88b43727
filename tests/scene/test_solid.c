/* Tests of the inside of open shells, and of places on their visible surface. */
#include <math.h>
#include <stdlib.h>

#include "ball.h"
#include "support.h"

/* The volume of a closed ball, and the kind of some places. */
static void a_closed_ball(void **state) {
    static ball b;
    context *c = test_context();
    solid_grid g;
    double volume = 0;
    ball_make(&b, (float[]){1, 2, 3}, 0.25f, 0, RINGS);
    assert_ok(c, solid_grid_create(c, 1, &b.mesh, 0.01f, 0, &g));
    for (int z = 0; z < g.size[2]; z++)
        for (int y = 0; y < g.size[1]; y++)
            for (int x = 0; x < g.size[0]; x++) {
                const float place[3] = {g.min[0] + ((float)x + 0.5f) * g.cell_m,
                                        g.min[1] + ((float)y + 0.5f) * g.cell_m,
                                        g.min[2] + ((float)z + 0.5f) * g.cell_m};
                volume += solid_contains(&g, place) * pow(0.01, 3);
            }
    assert_true(fabs(volume / (4. / 3 * M_PI * pow(0.25, 3)) - 1) < 0.04);
    assert_int_equal(solid_at(&g, (float[]){1, 2, 3}), SOLID_INSIDE);
    assert_int_equal(solid_at(&g, (float[]){1.25f, 2, 3}), SOLID_WALL);
    assert_int_equal(solid_at(&g, (float[]){1.2f, 2.2f, 3}), SOLID_OUTSIDE);
    assert_int_equal(solid_at(&g, (float[]){99, 0, NAN}), SOLID_OUTSIDE);
    solid_grid_free(&g);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* A body whose upper half is missing under an open cap, as under a shirt, is still solid. */
static void a_cap_over_half_a_body(void **state) {
    static ball body, cap;
    context *c = test_context();
    solid_grid g;
    const float middle[3] = {0, 0, 0};
    ball_make(&body, middle, 0.2f, RINGS / 2 - 1, RINGS);
    ball_make(&cap, middle, 0.205f, 0, RINGS / 2);
    const solid_mesh both[2] = {body.mesh, cap.mesh};
    assert_ok(c, solid_grid_create(c, 2, both, 0.01f, 0, &g));
    assert_true(solid_contains(&g, middle) && solid_contains(&g, (float[]){0, 0.18f, 0}));
    assert_true(solid_contains(&g, (float[]){0, -0.18f, 0}) && !solid_contains(&g, (float[]){0, 0.23f, 0}));
    solid_grid_free(&g);
    assert_ok(c, solid_grid_create(c, 1, both, 0.01f, 0, &g)); /* a bowl alone encloses nothing */
    assert_false(solid_contains(&g, middle));
    solid_grid_free(&g);
    sherf_context_free(c);
}

/* A shirt's hem: the cap ends 3 cm away from the body below it, whose covered part is missing. Sealed, the
 * body is solid and loses only a dent as wide as the gap. */
static void a_gap_at_the_hem(void **state) {
    static ball body, cap;
    context *c = test_context();
    solid_grid g;
    ball_make(&body, (float[]){0, 0, 0}, 0.2f, RINGS / 2, RINGS);
    ball_make(&cap, (float[]){0, 0, 0}, 0.23f, 0, RINGS / 2 + 1);
    const solid_mesh both[2] = {body.mesh, cap.mesh};
    assert_ok(c, solid_grid_create(c, 2, both, 0.01f, 0, &g));
    assert_false(solid_contains(&g, (float[]){0, 0.1f, 0})); /* it leaks */
    solid_grid_free(&g);
    assert_ok(c, solid_grid_create(c, 2, both, 0.01f, 2, &g));
    assert_true(solid_contains(&g, (float[]){0, 0.1f, 0}) && solid_contains(&g, (float[]){0, -0.15f, 0}));
    assert_false(solid_contains(&g, (float[]){0, 0.26f, 0}));
    assert_false(solid_contains(&g, (float[]){0.15f, -0.2f, 0}));
    solid_grid_free(&g);
    assert_ok(c, solid_grid_create(c, 1, both, 0.01f, 2, &g)); /* the bowl is still a bowl */
    assert_false(solid_contains(&g, (float[]){0, -0.1f, 0}));
    solid_grid_free(&g);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Points are on the mesh, distributed by area, and have outward normals; none is on the hidden inside. */
static void points_of_what_is_seen(void **state) {
    enum { COUNT = 4000 };
    static ball outer, inner;
    static solid_point p[COUNT];
    context *c = test_context();
    solid_grid g;
    int64_t found;
    int upper = 0;
    ball_make(&outer, (float[]){0, 0, 0}, 0.2f, 0, RINGS);
    ball_make(&inner, (float[]){0, 0, 0}, 0.1f, 0, RINGS);
    const solid_mesh both[2] = {inner.mesh, outer.mesh};
    assert_ok(c, solid_grid_create(c, 2, both, 0.01f, 0, &g));
    assert_ok(c, solid_points(c, &g, 2, both, 5, COUNT, p, &found));
    assert_int_equal(found, COUNT);
    for (int i = 0; i < COUNT; i++) {
        const float *v = p[i].position, *n = p[i].normal;
        const float r = sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        assert_int_equal(p[i].mesh, 1);
        assert_true(r > 0.198f && r < 0.20001f && p[i].triangle < outer.mesh.triangles);
        assert_true(fabsf(p[i].weight[0] + p[i].weight[1] + p[i].weight[2] - 1) < 1e-5f);
        assert_true((n[0] * v[0] + n[1] * v[1] + n[2] * v[2]) / r > 0.97f);
        upper += v[1] > 0.1f; /* a quarter of a ball's area */
    }
    assert_true(abs(upper - COUNT / 4) < 4 * sqrt(COUNT * 3. / 16));
    assert_ok(c, solid_points(c, &g, 1, both, 5, 10, p, &found)); /* none of it is seen */
    assert_int_equal(found, 0);
    solid_grid_free(&g);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void mistakes_are_one_line(void **state) {
    context *c = test_context();
    solid_grid g;
    float v[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint32_t t[3] = {0, 1, 2};
    const solid_mesh mesh = {3, 1, v, t}, none = {3, 0, v, t};
    assert_fails(c, solid_grid_create(c, 1, &none, 0.1f, 0, &g), SHERF_BAD_ARGUMENT, "no triangles");
    assert_fails(c, solid_grid_create(c, 1, &mesh, 0, 0, &g), SHERF_BAD_ARGUMENT, "no size");
    assert_fails(c, solid_grid_create(c, 1, &mesh, 1e-6f, 0, &g), SHERF_BAD_ARGUMENT, "more than");
    assert_fails(c, solid_grid_create(c, 1, &mesh, 0.1f, 65, &g), SHERF_BAD_ARGUMENT, "0 to 64");
    t[1] = 3;
    assert_fails(c, solid_grid_create(c, 1, &mesh, 0.1f, 0, &g), SHERF_BAD_ARGUMENT, "not there");
    t[1] = 1;
    v[4] = NAN;
    assert_fails(c, solid_grid_create(c, 1, &mesh, 0.1f, 0, &g), SHERF_BAD_ARGUMENT, "not finite");
    assert_null(g.cell);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_closed_ball), cmocka_unit_test(a_cap_over_half_a_body),
        cmocka_unit_test(a_gap_at_the_hem), cmocka_unit_test(points_of_what_is_seen),
        cmocka_unit_test(mistakes_are_one_line)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
