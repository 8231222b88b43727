/* Tests of the points near the body, against the reference and brute force. */
#include "body_reference.h"
#include "sampling/sampling.h"

/* The row of one of the reference's picked points among ours. */
static int64_t find_point(const point_set *p, int32_t ray, int32_t sample) {
    for (int32_t i = p->first[ray]; i < p->first[ray + 1]; i++)
        if (p->sample[i] == sample) return i;
    fail_msg("sample %d of ray %d was not kept", sample, ray);
    return -1;
}

/* Ties of the nearest canonical vertex: if another vertex is equally near up to rounding, either is allowed.
 */
static bool tied(const body_reference *r, const float p[3]) {
    double best = 1e30, second = 1e30;
    for (int v = 0; v < r->body->vertices; v++) {
        const float *x = r->body->canonical->vertices_smpl + 3 * v;
        double a = (double)x[0] - p[0], b = (double)x[1] - p[1], d = (double)x[2] - p[2],
               d2 = a * a + b * b + d * d;
        if (d2 < best)
            second = best, best = d2;
        else if (d2 < second)
            second = d2;
    }
    return second - best < 1e-5 * best;
}

static void points_agree(void **state) {
    body_reference *r = *state;
    ray_bundle *rays = target_rays(r, &r->target_camera);
    point_set *p;
    int64_t picked, n;
    assert_ok(r->c, points_create(r->c, r->body, r->target, rays, 48, r->observation, &r->observation_camera,
                                  NULL, true, &p));
    assert_int_equal(p->count, *reference_ints(r, "points.count", NULL));
    const int32_t *ray = reference_ints(r, "pick.ray", &picked),
                  *sample = reference_ints(r, "pick.sample", NULL);
    for (int64_t i = 0; i < picked; i++) find_point(p, ray[i], sample[i]);
    const int32_t *point = reference_ints(r, "point", &n), zero = 0;
    int ties = 0;
    for (int64_t i = 0; i < n; i++) {
        int64_t at = find_point(p, ray[point[i]], sample[point[i]]);
        const float *canonical = reference_floats(r, "deform.canonical") + 3 * i;
        assert_rows(p->canonical + 3 * at, canonical, &zero, 1, 3, 2e-6, "canonical");
        assert_rows(p->direction_canonical + 3 * at, reference_floats(r, "deform.viewdir") + 3 * i, &zero, 1,
                    3, 2e-6, "direction");
        if (tied(r, canonical)) {
            ties++;
            continue;
        }
        assert_rows(p->observation_world + 3 * at, reference_floats(r, "deform.observation") + 3 * i, &zero,
                    1, 3, 3e-6, "observation");
        assert_rows(p->observed_px + 2 * at, reference_floats(r, "project.points") + 2 * i, &zero, 1, 2, 5e-4,
                    "pixels");
    }
    assert_true(ties <= 2);
    points_free(p);
    rays_free(rays);
}

/* Every sample of a small frame one by one, with every instruction set, with one thread and three. */
static void points_are_exact(void **state) {
    body_reference *r = *state;
    const int samples = 70; /* more than one word of bits */
    sherf_camera small = r->target_camera;
    camera_resize(&small, 20, 24);
    ray_bundle *rays = target_rays(r, &small);
    vertex_grid *g;
    assert_ok(r->c, vertex_grid_create(r->c, r->body->vertices, r->target->vertices_smpl, BODY_SHELL_M, &g));
    for (int run = 0; run < 2 * ISA_AMX; run++) {
        if (!test_isa((isa_level)(run % ISA_AMX))) continue;
        r->c->threads = run < ISA_AMX ? 1 : 3;
        point_set *p;
        assert_ok(r->c, points_create(r->c, r->body, r->target, rays, samples, NULL, NULL, NULL, true, &p));
        assert_null(p->observed_px);
        int64_t at = 0;
        for (int n = 0; n < 20 * 24; n++) {
            assert_int_equal(p->first[n], at);
            for (int i = 0; i < samples && rays->at_box[n]; i++) {
                float t = rays->near[n] + (rays->far[n] - rays->near[n]) * ray_fraction(i, samples), x[3],
                      s[3];
                for (int k = 0; k < 3; k++)
                    x[k] = rays->origin_world[k] + t * rays->direction[3 * n + k] - r->target->Th[k];
                for (int k = 0; k < 3; k++)
                    s[k] = x[0] * r->target->R[k] + x[1] * r->target->R[3 + k] + x[2] * r->target->R[6 + k];
                int32_t nearest = vertex_grid_nearest(g, s, NULL);
                if (nearest < 0) continue;
                assert_true(at < p->count);
                assert_int_equal(p->ray[at], n);
                assert_int_equal(p->sample[at], i);
                assert_int_equal(p->nearest[at], nearest);
                at++;
            }
        }
        assert_int_equal(at, p->count);
        assert_int_equal(p->first[20 * 24], at);
        assert_true(at > 500);
        points_free(p);
    }
    test_isa_restore();
    r->c->threads = 2;
    vertex_grid_free(g);
    rays_free(rays);
}

static void nobody_in_sight(void **state) {
    body_reference *r = *state;
    sherf_camera away = r->target_camera;
    for (int k = 0; k < 6; k++) away.R[k + 3] = -away.R[k + 3]; /* half a turn about x: looks the other way */
    away.T_m[2] = -away.T_m[2] - 10;
    ray_bundle *rays = target_rays(r, &away);
    point_set *p;
    assert_ok(r->c, points_create(r->c, r->body, r->target, rays, 48, r->observation, &r->observation_camera,
                                  NULL, false, &p));
    assert_int_equal(p->count, 0);
    for (int n = 0; n < 128 * 128; n++) assert_false(rays->at_box[n]);
    points_free(p);
    assert_int_equal(points_create(r->c, r->body, r->target, rays, 0, NULL, NULL, NULL, false, &p),
                     SHERF_BAD_ARGUMENT);
    assert_int_equal(points_create(r->c, r->body, r->target, rays, 48, r->observation, NULL, NULL, false, &p),
                     SHERF_BAD_ARGUMENT);
    rays_free(rays);
}

/* ---- every allocation failing in turn ---- */
static sherf_status make_points(body_reference *r, const sherf_camera *small, const ray_bundle *rays) {
    point_set *p = NULL;
    const sherf_status status =
        points_create(r->c, r->body, r->target, rays, 48, r->observation, small, NULL, true, &p);
    points_free(p);
    return status;
}

static void allocations_may_fail(void **state) {
    target_no_memory(*state, make_points, 20);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(points_agree), cmocka_unit_test(points_are_exact),
                                       cmocka_unit_test(nobody_in_sight),
                                       cmocka_unit_test(allocations_may_fail)};
    return cmocka_run_group_tests(tests, body_reference_open, body_reference_close);
}
