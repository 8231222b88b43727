/* Tests of interpolated rotations, and of changes to clips in time and place. */
#include "walk.h"

static void some_turn(int n, double max_rad, float q[4]) {
    double v[3];
    for (int k = 0; k < 3; k++) v[k] = max_rad * (2 * random_uniform(77, (uint64_t)(3 * n + k)) - 1);
    quaternion_from_axis_angle(v, q);
}

static void slerp_properties(void **state) {
    for (int n = 0; n < 200; n++) {
        float a[4], b[4], at[4], other[4], minus[4], left[4], turned[4];
        some_turn(3 * n, 3, a);
        some_turn(3 * n + 1, 3, b);
        some_turn(3 * n + 2, 3, left);
        double whole = quaternion_angle(a, b), t = random_uniform(5, (uint64_t)n);
        assert_true(whole <= M_PI + 1e-6);
        quaternion_slerp(a, b, t, at);
        assert_float_equal(quaternion_angle(a, at), t * whole, 2e-3); /* constant speed, the shorter way */
        assert_float_equal(quaternion_angle(at, b), (1 - t) * whole, 2e-3);
        for (int k = 0; k < 4; k++) minus[k] = -b[k]; /* the same rotation */
        quaternion_slerp(a, minus, t, other);
        assert_true(quaternion_angle(at, other) < 2e-3);
        quaternion_multiply(left, a, a); /* rotating both ends rotates the path */
        quaternion_multiply(left, b, b);
        quaternion_slerp(a, b, t, other);
        quaternion_multiply(left, at, turned);
        assert_true(quaternion_angle(turned, other) < 2e-3);
    }
}

static void turns_round_trip(void **state) {
    for (int n = 0; n < 300; n++) {
        float q[4], again[4], v[3];
        double R[9], wide[3];
        some_turn(n, n < 100 ? 1e-4 : n < 200 ? 1.8 : 3.14, q);
        quaternion_to_matrix(q, R);
        quaternion_from_matrix(R, again);
        assert_true(quaternion_angle(q, again) < 1e-3);
        quaternion_to_axis_angle(q, v);
        for (int k = 0; k < 3; k++) wide[k] = v[k];
        quaternion_from_axis_angle(wide, again);
        assert_true(quaternion_angle(q, again) < 1e-6);
        assert_true(v[0] * v[0] + v[1] * v[1] + v[2] * v[2] < (M_PI + 1e-5) * (M_PI + 1e-5));
    }
}

/* A clip whose joints turn at different speeds while the pelvis moves steadily. */
static void steady(context *c, int frames, double fps, clip *k) {
    assert_ok(c, clip_create(c, frames, fps, k));
    for (int i = 0; i < frames; i++) {
        for (int j = 0; j < BODY_JOINTS; j++) {
            double v[3] = {0, 0, 0};
            v[j % 3] = 0.3 + (0.2 + 0.1 * j) * i / fps;
            quaternion_from_axis_angle(v, k->turn[i][j]);
        }
        for (int a = 0; a < 3; a++) k->pelvis_m[i][a] = (float)(a + (a + 1.0) * i / fps);
    }
}

static double difference(const clip *a, const clip *b) {
    double max = 0;
    assert_int_equal(a->frames, b->frames);
    for (int i = 0; i < a->frames; i++) {
        for (int j = 0; j < BODY_JOINTS; j++) max = fmax(max, quaternion_angle(a->turn[i][j], b->turn[i][j]));
        for (int k = 0; k < 3; k++) max = fmax(max, fabs((double)a->pelvis_m[i][k] - b->pelvis_m[i][k]));
    }
    return max;
}

static void resampling(void **state) {
    context *c = ((walk_fixture *)*state)->c;
    clip slow, fast;
    steady(c, 31, 30, &slow);
    steady(c, 101, 100, &fast);
    assert_ok(c, clip_resample(c, &slow, 100)); /* one second of the same motion */
    assert_int_equal(slow.frames, 101);
    assert_true(difference(&slow, &fast) < 1e-5);
    clip_free(&slow);
    steady(c, 31, 30, &slow);
    assert_ok(c, clip_resample(c, &fast, 30));
    assert_true(difference(&slow, &fast) < 1e-5);
    assert_int_equal(clip_resample(c, &fast, 1e9), SHERF_BAD_ARGUMENT); /* the clip is unchanged */
    assert_true(difference(&slow, &fast) < 1e-5);
    clip_free(&slow);
    clip_free(&fast);
}

static void gaps_are_filled(void **state) {
    context *c = ((walk_fixture *)*state)->c;
    clip whole, part;
    steady(c, 10, 30, &whole);
    steady(c, 10, 30, &part);
    static const int64_t number[] = {100, 101, 104, 105, 109};
    for (int i = 0; i < 5; i++) {
        memcpy(part.turn[i], whole.turn[number[i] - 100], sizeof part.turn[i]);
        memcpy(part.pelvis_m[i], whole.pelvis_m[number[i] - 100], sizeof part.pelvis_m[i]);
    }
    part.frames = 5;
    assert_ok(c, clip_spread(c, &part, number));
    assert_true(difference(&part, &whole) < 1e-5);
    part.frames = 2;
    assert_int_equal(clip_spread(c, &part, (const int64_t[]){0, INT64_MAX / 2}), SHERF_BAD_FILE);
    assert_int_equal(clip_spread(c, &part, (const int64_t[]){5, 5}), SHERF_BAD_FILE);
    part.frames = 10;
    clip_free(&part);
    clip_free(&whole);
}

static void smoothing(void **state) {
    context *c = ((walk_fixture *)*state)->c;
    clip clean, noisy, smooth;
    steady(c, 60, 30, &clean);
    steady(c, 60, 30, &smooth);
    assert_ok(c, clip_smooth(c, &smooth, 0.1)); /* steady motion stays the same, up to its very ends */
    assert_true(difference(&clean, &smooth) < 1e-4);
    clip_free(&smooth);
    steady(c, 60, 30, &noisy);
    for (int i = 0; i < noisy.frames; i++)
        for (int j = 0; j < BODY_JOINTS; j++) {
            float shake[4];
            some_turn(1000 + 24 * i + j, 0.1, shake);
            quaternion_multiply(noisy.turn[i][j], shake, noisy.turn[i][j]);
        }
    double before = 0, after = 0;
    for (int i = 10; i < 50; i++) before += quaternion_angle(noisy.turn[i][5], clean.turn[i][5]);
    assert_ok(c, clip_smooth(c, &noisy, 0.1));
    for (int i = 10; i < 50; i++) after += quaternion_angle(noisy.turn[i][5], clean.turn[i][5]);
    assert_true(after < 0.5 * before); /* a Gaussian of 3 frames leaves 0.31 of white noise */
    clip_free(&clean);
    clip_free(&noisy);
}

/* Played repeatedly, no step is much longer than the clip's own steps, including the one across the seam. */
static void loops_close(void **state) {
    walk_fixture *f = *state;
    clip k;
    assert_ok(f->c, clip_create(f->c, 40, 30, &k));
    for (int i = 0; i < k.frames; i++) {
        sherf_pose p = f->walk.pose[0];
        pose_walk(i / 41.0, 1, p.poses_rad);
        p.poses_rad[0] = p.poses_rad[2] = 0, p.poses_rad[1] = (float)(0.02 * i);
        for (int a = 0; a < 3; a++) p.Th_m[a] = (float)(a == 1 ? 1.1 : 0.03 * i);
        pose_to_turns(&p, &f->walk.skeleton, k.turn[i], k.pelvis_m[i]);
    }
    clip_loop(&k);
    assert_int_equal(k.frames, 39);
    double step = 0, seam = 0;
    for (int j = 0; j < BODY_JOINTS; j++) {
        for (int i = 1; i < k.frames; i++)
            step = fmax(step, quaternion_angle(k.turn[i - 1][j], k.turn[i][j]));
        seam = fmax(seam, quaternion_angle(k.turn[k.frames - 1][j], k.turn[0][j]));
    }
    assert_true(seam < 1.2 * step && step < 0.25);
    for (int a = 0; a < 3; a++)
        assert_float_equal(k.pelvis_m[38][a], k.pelvis_m[0][a], 1e-3); /* on the spot */
    clip_free(&k);
}

static void lead_in(void **state) {
    walk_fixture *f = *state;
    clip k;
    float turn[BODY_JOINTS][4], pelvis[3];
    steady(f->c, 5, 30, &k);
    pose_to_turns(&f->walk.pose[3], &f->walk.skeleton, turn, pelvis);
    assert_ok(f->c, clip_lead_in(f->c, &k, 15, (const float(*)[4])turn, pelvis));
    assert_int_equal(k.frames, 20);
    for (int j = 0; j < BODY_JOINTS; j++) {
        assert_true(quaternion_angle(k.turn[0][j], turn[j]) < 1e-6);
        double whole = quaternion_angle(turn[j], k.turn[15][j]);
        for (int i = 1; i <= 15; i++) /* smoothstep is steepest in its middle, at 1.5 */
            assert_true(quaternion_angle(k.turn[i - 1][j], k.turn[i][j]) <= 1.51 * whole / 15 + 1e-5);
        assert_true(quaternion_angle(k.turn[14][j], k.turn[15][j]) <= 0.2 * whole / 15 + 1e-3);
    }
    clip_free(&k);
}

static void up_and_root(void **state) {
    walk_fixture *f = *state;
    static const double y[3] = {0, 1, 0};
    clip k;
    double up[3];
    assert_ok(f->c, clip_create(f->c, WALK_FRAMES, walk_fps, &k));
    for (int i = 0; i < k.frames; i++)
        pose_to_turns(&f->walk.pose[i], &f->walk.skeleton, k.turn[i], k.pelvis_m[i]);
    clip_mean_up(&k, up);
    assert_true(up[1] > 0.99);
    clip_upright(&k, SHERF_UP_Z); /* with z taken as up, the body lies */
    clip_mean_up(&k, up);
    assert_true(up[2] < -0.99);
    clip_upright(&k, SHERF_UP_MINUS_Y);
    clip_mean_up(&k, up);
    assert_true(up[2] > 0.99);
    clip_upright(&k, SHERF_UP_Z);
    clip_mean_up(&k, up);
    assert_true(up[1] > 0.99);
    clip_root(&k, &f->walk.skeleton, SHERF_ROOT_GROUNDED);
    for (int i = 0; i < k.frames; i++)
        assert_float_equal(skeleton_lowest(&f->walk.skeleton, (const float(*)[4])k.turn[i], k.pelvis_m[i], y),
                           0, 1e-5);
    assert_true(k.pelvis_m[11][0] - k.pelvis_m[0][0] > 0.3);
    clip_root(&k, &f->walk.skeleton, SHERF_ROOT_DROPPED);
    for (int i = 0; i < k.frames; i++)
        for (int a = 0; a < 3; a += 2) assert_float_equal(k.pelvis_m[i][a], k.pelvis_m[0][a], 0);
    clip_free(&k);
}

/* The lowest vertex of the walk is near the height that the skeleton gives. */
static void lowest_is_near_the_mesh(void **state) {
    walk_fixture *f = *state;
    static const double y[3] = {0, 1, 0};
    float *v = malloc((size_t)f->body->vertices * 3 * sizeof *v);
    for (int i = 0; i < WALK_FRAMES; i++) {
        float turn[BODY_JOINTS][4], pelvis[3], low = INFINITY;
        assert_ok(f->c, sherf_body_pose(f->c, f->body, &f->walk.pose[i], v, NULL));
        for (int n = 0; n < f->body->vertices; n++) low = fminf(low, v[3 * n + 1]);
        pose_to_turns(&f->walk.pose[i], &f->walk.skeleton, turn, pelvis);
        assert_float_equal(skeleton_lowest(&f->walk.skeleton, (const float(*)[4])turn, pelvis, y), low, 0.04);
    }
    free(v);
}

/* In any world, the first frame is at the pose's place, on its ground, facing the same way. Distances and
 * relative rotations do not change. */
static void starts_where_it_should(void **state) {
    walk_fixture *f = *state;
    static const double worlds[][9] = {{1, 0, 0, 0, 1, 0, 0, 0, 1},
                                       {1, 0, 0, 0, 0, -1, 0, 1, 0},
                                       {1, 0, 0, 0, -1, 0, 0, 0, -1},
                                       {0, 0, 1, 1, 0, 0, 0, 1, 0}};
    for (size_t n = 0; n < COUNT_OF(worlds); n++) {
        sherf_pose start = f->walk.pose[5];
        clip k;
        float turn[BODY_JOINTS][4], pelvis[3];
        double B[9], own[9], up[3];
        for (int i = 0; i < 9; i++) start.R[i] = (float)worlds[n][i];
        start.Th_m[0] = 3;
        assert_ok(f->c, clip_create(f->c, WALK_FRAMES, walk_fps, &k));
        for (int i = 0; i < k.frames; i++)
            pose_to_turns(&f->walk.pose[i], &f->walk.skeleton, k.turn[i], k.pelvis_m[i]);
        double far = fabs((double)k.pelvis_m[11][0] - k.pelvis_m[0][0]);
        float relative = (float)quaternion_angle(k.turn[0][0], k.turn[11][0]);
        clip_start_at(&k, &f->walk.skeleton, &start);
        pose_to_turns(&start, &f->walk.skeleton, turn, pelvis);
        pose_axes(&start, B);
        for (int i = 0; i < 3; i++) up[i] = B[3 * i + 1];
        assert_float_equal(fabs(worlds[n][1] * up[0] + worlds[n][4] * up[1] + worlds[n][7] * up[2]), 1, 1e-9);
        double along = 0, across = 0;
        for (int i = 0; i < 3; i++) along += ((double)k.pelvis_m[0][i] - pelvis[i]) * up[i];
        for (int i = 0; i < 3; i++) across += pow((double)k.pelvis_m[0][i] - pelvis[i] - along * up[i], 2);
        assert_true(sqrt(across) < 1e-4);
        assert_float_equal(
            skeleton_lowest(&f->walk.skeleton, (const float(*)[4])k.turn[0], k.pelvis_m[0], up),
            skeleton_lowest(&f->walk.skeleton, (const float(*)[4])turn, pelvis, up), 1e-4);
        sherf_pose first;
        sherf_pose_identity(&first);
        quaternion_to_axis_angle(k.turn[0][0], first.poses_rad);
        pose_axes(&first, own);
        for (int i = 0; i < 9; i++) assert_float_equal(own[i], B[i], 1e-4);
        assert_float_equal(quaternion_angle(k.turn[0][0], k.turn[11][0]), relative, 1e-3);
        double moved = 0;
        for (int i = 0; i < 3; i++) moved += pow((double)k.pelvis_m[11][i] - k.pelvis_m[0][i], 2);
        assert_true(sqrt(moved) > far); /* the person still walks */
        clip_free(&k);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(slerp_properties),
                                       cmocka_unit_test(turns_round_trip),
                                       cmocka_unit_test(resampling),
                                       cmocka_unit_test(gaps_are_filled),
                                       cmocka_unit_test(smoothing),
                                       cmocka_unit_test(loops_close),
                                       cmocka_unit_test(lead_in),
                                       cmocka_unit_test(up_and_root),
                                       cmocka_unit_test(lowest_is_near_the_mesh),
                                       cmocka_unit_test(starts_where_it_should)};
    return cmocka_run_group_tests(tests, walk_setup, walk_teardown);
}
