/* Tests of points of the body: their places by skinning, and their derivatives against central differences.
 * The open body keeps volume and the tube people's body has posedirs, so both kinds of pose offsets are
 * tested. */
#include <math.h>
#include <string.h>

#include "support.h"
#include "data/data.h"
#include "synth/tube/tubeman.h"
#include "estimate/body_points.h"

enum { BODIES = 2, POINTS = 60 };
static body_model *body[BODIES];

static int open_bodies(void **state) {
    context *c = *state = test_context();
    assert_ok(c, body_load(c, "../assets/body.safetensors", &body[0]));
    assert_ok(c, tubeman_create(c, &body[1]));
    assert_non_null(body[0]->pose_volume);
    assert_non_null(body[1]->posedirs);
    return 0;
}

static int close_bodies(void **state) {
    for (int b = 0; b < BODIES; b++) sherf_body_free(body[b]);
    sherf_context_free(*state);
    return 0;
}

/* A pose bent at every joint, turned, with a shape; one joint is not bent at all, another hardly. */
static void any_state(uint64_t key, body_state *s) {
    double turn[3];
    uint64_t n = 0;
    for (int k = 0; k < 3; k++) turn[k] = 1.5 * random_normal(key, n++);
    rotation_exp(turn, s->root, NULL);
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++)
            s->bend[j][k] = (j == 5 ? 0 : j == 7 ? 1e-3 : 0.6) * random_normal(key, n++);
    for (int i = 0; i < BODY_SHAPES; i++) s->shape[i] = random_normal(key, n++);
    for (int k = 0; k < 3; k++) s->pelvis_m[k] = random_normal(key, n++) + 4 * (k == 2);
}

static body_points *any_points(context *c, const body_model *of, body_point list[POINTS]) {
    body_points *p;
    for (int i = 0; i < POINTS; i++) {
        list[i] = (body_point){.vertex = (int)random_below(9, (uint64_t)i, of->vertices)};
        if (i % 4) continue;
        list[i] =
            (body_point){.vertex = -1, .joint = i / 4 * 5 % BODY_JOINTS, .offset_m = {0.1, -0.02, 0.05}};
    }
    assert_ok(c, body_points_create(c, of, POINTS, list, &p));
    assert_int_equal(body_points_count(p), POINTS);
    return p;
}

/* The same body by pose.c: vertices directly, joints through the maps of the joints. */
static void points_lie_where_skinning_puts_them(void **state) {
    context *c = *state;
    for (int b = 0; b < BODIES; b++) {
        body_point list[POINTS];
        body_points *p = any_points(c, body[b], list);
        body_state s;
        any_state(3, &s);
        double place[POINTS][3];
        body_points_place(p, &s, place[0], NULL, NULL);
        float pose[72], shape[BODY_SHAPES], R[9], Th[3] = {0};
        for (int i = 0; i < 9; i++) R[i] = (float)s.root[i];
        for (int i = 0; i < 72; i++) pose[i] = i < 3 ? 0 : (float)s.bend[i / 3][i % 3];
        for (int i = 0; i < BODY_SHAPES; i++) shape[i] = (float)s.shape[i];
        posed_body *posed;
        assert_ok(c, posed_body_create(c, body[b], pose, shape, R, Th, &posed));
        for (int i = 0; i < POINTS; i++) {
            const float *x = posed->vertices_smpl + 3 * (size_t)(list[i].vertex < 0 ? 0 : list[i].vertex);
            float y[3];
            if (list[i].vertex < 0) {
                const float *A = posed->transform[list[i].joint];
                for (int k = 0; k < 3; k++) {
                    double sum = (double)A[4 * k + 3];
                    for (int a = 0; a < 3; a++)
                        sum += (double)A[4 * k + a] *
                               ((double)posed->joints_rest[list[i].joint][a] + list[i].offset_m[a]);
                    y[k] = (float)sum;
                }
                x = y;
            }
            for (int r = 0; r < 3; r++) {
                double world = s.pelvis_m[r];
                for (int k = 0; k < 3; k++)
                    world += s.root[3 * r + k] * ((double)x[k] - (double)posed->joints_rest[0][k]);
                assert_true(fabs(world - place[i][r]) < 5e-6);
            }
        }
        posed_body_free(posed);
        body_points_free(p);
    }
}

static void derivatives_agree_with_differences(void **state) {
    context *c = *state;
    for (int b = 0; b < BODIES; b++) {
        body_point list[POINTS];
        body_points *p = any_points(c, body[b], list);
        body_state s, moved;
        any_state(4, &s);
        double *slope = mem_alloc(c, (size_t)POINTS * 3 * BODY_UNKNOWNS, sizeof *slope);
        double place[POINTS][3], ahead[POINTS][3], behind[POINTS][3], h = 1e-5, max = 0;
        body_points_place(p, &s, place[0], slope, NULL);
        for (int u = 0; u < BODY_UNKNOWNS; u++) {
            double step[BODY_UNKNOWNS] = {0};
            step[u] = h;
            body_state_move(&s, step, &moved);
            body_points_place(p, &moved, ahead[0], NULL, NULL);
            step[u] = -h;
            body_state_move(&s, step, &moved);
            body_points_place(p, &moved, behind[0], NULL, NULL);
            for (int i = 0; i < POINTS; i++)
                for (int k = 0; k < 3; k++) {
                    double difference = (ahead[i][k] - behind[i][k]) / (2 * h);
                    double own = slope[(3 * (size_t)i + (size_t)k) * BODY_UNKNOWNS + (size_t)u];
                    if (fabs(difference - own) > 1e-8)
                        fail_msg("body %d, unknown %d, point %d, axis %d: %g, by differences %g", b, u, i, k,
                                 own, difference);
                    max = fmax(max, fabs(own));
                }
        }
        assert_true(max > 0.5);
        mem_free(slope);
        body_points_free(p);
    }
}

static void bad_points_are_refused(void **state) {
    context *c = *state;
    body_points *p;
    body_point wrong = {.vertex = body[0]->vertices};
    assert_int_equal(body_points_create(c, body[0], 1, &wrong, &p), SHERF_BAD_ARGUMENT);
    assert_null(p);
    wrong = (body_point){.vertex = -1, .joint = BODY_JOINTS};
    assert_int_equal(body_points_create(c, body[0], 1, &wrong, &p), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "joint 24"));
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(points_lie_where_skinning_puts_them),
                                       cmocka_unit_test(derivatives_agree_with_differences),
                                       cmocka_unit_test(bad_points_are_refused)};
    return cmocka_run_group_tests(tests, open_bodies, close_bodies);
}
