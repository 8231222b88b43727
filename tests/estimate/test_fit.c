/* Tests of the fit on known bodies: landmarks are computed from a pose, a shape and a camera, with the
 * networks' errors and noise and a mask drawn from the body. The fit must recover them. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "open_body.h"
#include "base/vector3.h"
#include "estimate/fit_inside.h"
#include "sampling/sampling.h"

enum { SIDE = 512 };
/* A person as the camera sees them. turn_rad: about the vertical, 0 faces the camera. */
typedef struct {
    double turn_rad, pitch_rad, distance_m, rise_m, focal_px, lean_rad, noise_px;
    double hip, knee, spread, lift, forward, elbow; /* angles, the same on both sides */
    double clothes;                                 /* relative to the usual clothes */
    bool faults, mask;
} scene;
static const scene standing = {
    .distance_m = 4, .focal_px = 700, .spread = 0.08, .lift = -1.15, .elbow = -0.3, .mask = true};

typedef struct {
    photo_person person;
    body_fit_input in;
    sherf_image mask;
    body_state truth; /* in the camera's frame */
    double joint[BODY_JOINTS][3], up[3];
} shot;

static void pose_body(const scene *w, body_state *s) {
    const double turn[3] = {0, w->turn_rad, 0}, lean[3] = {w->lean_rad, 0, 0},
                 over[3] = {M_PI + w->pitch_rad, 0, 0};
    double yaw[9], tilt[9], camera[9];
    memset(s, 0, sizeof *s);
    rotation_exp(turn, yaw, NULL);
    rotation_exp(lean, tilt, NULL);
    rotation_exp(over, camera, NULL); /* y up to y down, and the camera's pitch */
    multiply3(yaw, tilt, yaw);
    multiply3(camera, yaw, s->root);
    for (int side = 0; side < 2; side++) {
        double sign = side ? -1 : 1;
        s->bend[1 + side][0] = w->hip, s->bend[1 + side][2] = sign * w->spread;
        s->bend[4 + side][0] = w->knee;
        s->bend[7 + side][0] = -(w->hip + w->knee + w->lean_rad);
        s->bend[16 + side][1] = sign * w->forward, s->bend[16 + side][2] = sign * w->lift;
        s->bend[18 + side][1] = sign * w->elbow;
    }
    s->shape[0] = 0.4, s->shape[1] = -0.3, s->shape[2] = 0.3;
    s->pelvis_m[1] = w->rise_m, s->pelvis_m[2] = w->distance_m;
}

/* The networks' depth error along the ray, in addition to being a quarter too short. */
static double fault_m(int l) {
    if (l <= LANDMARK_RIGHT_EAR) return -0.065;
    if (l == LANDMARK_LEFT_KNEE || l == LANDMARK_RIGHT_KNEE) return -0.03;
    return l >= LANDMARK_LEFT_ANKLE ? 0.04 : 0;
}

/* Landmarks as the networks would see them. */
static void make_landmarks(context *c, const scene *w, shot *o) {
    body_point list[LANDMARKS];
    body_points *p;
    double place[LANDMARKS][3];
    for (int l = 0; l < LANDMARKS; l++) {
        const fit_landmark *f = &fit_landmarks[l];
        list[l] = (body_point){.vertex = -1, .joint = f->joint < 0 ? 15 : f->joint};
        memcpy(list[l].offset_m, f->offset_m, sizeof f->offset_m);
    }
    assert_ok(c, body_points_create(c, body, LANDMARKS, list, &p));
    body_points_place(p, &o->truth, place[0], NULL, NULL);
    body_points_free(p);
    for (int l = 0; l < LANDMARKS; l++) {
        landmark *out = &o->person.landmark[l];
        out->visible = out->present = 1;
        for (int k = 0; k < 2; k++)
            out->place_px[k] = (float)(w->focal_px * place[l][k] / place[l][2] + 0.5 * (SIDE - 1) +
                                       w->noise_px * random_normal(5, (uint64_t)(10 * l + k)));
        for (int k = 0; k < 3; k++) {
            double x = place[l][k] - 0.5 * (place[LANDMARK_LEFT_HIP][k] + place[LANDMARK_RIGHT_HIP][k]);
            if (w->faults && k == 2) x = 0.75 * x + fault_m(l);
            out->place_m[k] = (float)(x + 0.01 * w->noise_px * random_normal(5, (uint64_t)(10 * l + 3 + k)));
        }
    }
}

/* Moves vertices outward as far as clothes, hair and soles extend beyond the body. */
static void dress(context *c, double clothes, float *v) {
    const size_t n = 3 * (size_t)body->vertices;
    float *rest = mem_alloc(c, n, sizeof *rest), *posed = mem_alloc(c, n, sizeof *posed);
    assert_ok(c, body_normals(c, body, body->v_template, rest));
    assert_ok(c, body_normals(c, body, v, posed));
    for (size_t i = 0; i < n; i += 3) {
        const double normal[3] = {(double)rest[i], (double)rest[i + 1], (double)rest[i + 2]},
                     beyond_m = clothes * fit_clothes_at(body, (int)(i / 3), normal);
        for (size_t k = 0; k < 3; k++) v[i + k] += (float)beyond_m * posed[i + k];
    }
    mem_free(rest);
    mem_free(posed);
}

static void draw_mask(context *c, const scene *w, shot *o) {
    float pose[72] = {0}, shape[BODY_SHAPES], R[9], none[3] = {0};
    posed_body *p;
    raster *r;
    sherf_camera k = {.width_px = SIDE, .height_px = SIDE, .R = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    for (int i = 3; i < 72; i++) pose[i] = (float)o->truth.bend[i / 3][i % 3];
    for (int b = 0; b < BODY_SHAPES; b++) shape[b] = (float)o->truth.shape[b];
    for (int i = 0; i < 9; i++) R[i] = (float)o->truth.root[i];
    assert_ok(c, posed_body_create(c, body, pose, shape, R, none, &p));
    for (int i = 0; i < 3; i++) {
        p->Th[i] = (float)o->truth.pelvis_m[i];
        for (int j = 0; j < 3; j++) p->Th[i] -= R[3 * i + j] * p->joints_rest[0][j];
    }
    float *v = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *v);
    body_vertices_world(body, p, v);
    dress(c, w->clothes, v);
    k.K[0] = k.K[4] = (float)w->focal_px;
    k.K[2] = k.K[5] = 0.5f * (SIDE - 1);
    k.K[8] = 1;
    assert_ok(c, raster_create(c, &k, 1, body->vertices, v, body->faces, body->face, &r));
    o->mask = (sherf_image){SIDE, SIDE, 1, mem_alloc(c, (size_t)SIDE * SIDE, sizeof(float))};
    for (int i = 0; i < SIDE * SIDE; i++) o->mask.data[i] = r->face[i] >= 0;
    raster_free(r);
    mem_free(v);
    posed_body_free(p);
}

static void take(context *c, const scene *w, shot *o) {
    memset(o, 0, sizeof *o);
    pose_body(w, &o->truth);
    fit_state s = {.pitch = w->pitch_rad};
    fit_up(&s, o->up);
    o->person.score = 1;
    o->person.region = (photo_region){{SIDE / 2.f, SIDE / 2.f}, SIDE, 0};
    make_landmarks(c, w, o);
    if (w->mask) draw_mask(c, w, o);
    o->in = (body_fit_input){
        .person = &o->person, .width_px = SIDE, .height_px = SIDE, .mask = w->mask ? &o->mask : NULL};
    body_point list[BODY_JOINTS];
    for (int j = 0; j < BODY_JOINTS; j++) list[j] = (body_point){.vertex = -1, .joint = j};
    body_points *p;
    assert_ok(c, body_points_create(c, body, BODY_JOINTS, list, &p));
    body_points_place(p, &o->truth, o->joint[0], NULL, NULL);
    body_points_free(p);
}

/* Joints of a result in the camera's frame. */
static void joints_of(context *c, const body_fit_result *r, double joint[BODY_JOINTS][3]) {
    float world[3 * BODY_JOINTS];
    assert_ok(c, sherf_body_pose(c, body, &r->pose, NULL, world));
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int i = 0; i < 3; i++) {
            joint[j][i] = (double)r->camera.T_m[i];
            for (int k = 0; k < 3; k++) joint[j][i] += (double)(r->camera.R[3 * i + k] * world[3 * j + k]);
        }
}

/* Mean distance of the 22 joints before the hands with the pelvis in one place. */
static double joint_error(context *c, const shot *o, const body_fit_result *r) {
    double joint[BODY_JOINTS][3], sum = 0;
    joints_of(c, r, joint);
    for (int j = 0; j < 22; j++) {
        double squared = 0;
        for (int k = 0; k < 3; k++) {
            double d = joint[j][k] - joint[0][k] - o->joint[j][k] + o->joint[0][k];
            squared += d * d;
        }
        sum += sqrt(squared);
    }
    return sum / 22;
}

static void fit_and_check(context *c, const char *name, const scene *w, double max_m, body_fit_result *r) {
    static shot o;
    take(c, w, &o);
    sherf_status status = body_fit(c, body, &o.in, r);
    if (status) fail_msg("%s: %s", name, c->message);
    double error = joint_error(c, &o, r);
    if (!(error < max_m)) fail_msg("%s: joints are off by %.0f mm", name, 1000 * error);
    assert_true(rotation_is_valid(r->camera.R));
    mem_free(o.mask.data);
}

static void standing_people_stand(void **state) {
    context *c = *state;
    body_fit_result r;
    scene w = standing;
    fit_and_check(c, "standing", &w, 0.035, &r);
    assert_true(r.stands && !r.from_behind && !r.cut_feet && !r.poor);
    assert_true(fabs(r.lean_rad) < 5 * M_PI / 180);
    assert_true(r.iou > 0.85 && r.landmarks_px < 0.01 * r.height_px);
    w.pitch_rad = 0.25, w.rise_m = 0.1; /* seen from above, and with the networks' errors */
    w.faults = true, w.noise_px = 2;
    fit_and_check(c, "from above", &w, 0.055, &r);
    assert_true(fabs(r.lean_rad) < 8 * M_PI / 180);
    assert_true(fabs(r.pitch_rad - w.pitch_rad) < 8 * M_PI / 180);
    for (int knee = 4; knee <= 5; knee++) {
        double bent = 0;
        for (int k = 0; k < 3; k++)
            bent += (double)(r.pose.poses_rad[3 * knee + k] * r.pose.poses_rad[3 * knee + k]);
        assert_true(sqrt(bent) < 20 * M_PI / 180);
    }
}

/* A person with clothes, hair and soles is not fitted larger than a bare one; nor is a bare one fitted
 * thinner. */
static void clothes_are_not_the_body(void **state) {
    context *c = *state;
    static shot o;
    double size[2], covered[2];
    for (int i = 0; i < 2; i++) {
        scene w = standing;
        body_fit_result r;
        w.clothes = i ? 1.3 : 0;
        fit_and_check(c, i ? "dressed" : "bare", &w, 0.03, &r);
        size[i] = r.height_px;
        covered[i] = r.mask_covered;
    }
    take(c, &standing, &o);
    mem_free(o.mask.data);
    assert_true(covered[0] > 0.93 && covered[1] < covered[0] - 0.05);
    assert_true(fabs(size[1] / size[0] - 1) < 0.012);
}

/* The gradient in the equations is that of the cost, around poses of several kinds and the limits. */
static void priors_have_their_slopes(void **state) {
    context *c = *state;
    const double move = 1e-6;
    body_point list[FIT_MARKS] = {0};
    body_fit_input in = {0};
    fit_problem p = {.body = body, .in = &in, .focal_guess_px = 700, .focal_spread = 0.2};
    fit_equations *e = mem_alloc(c, 1, sizeof *e);
    for (int i = 0; i < FIT_MARKS; i++) list[i].vertex = -1;
    p.mark_place = mem_alloc(c, FIT_MARKS, 3 * sizeof *p.mark_place);
    p.mark_slope = mem_alloc(c, FIT_MARKS, 3 * BODY_UNKNOWNS * sizeof *p.mark_slope);
    assert_ok(c, body_points_create(c, body, FIT_MARKS, list, &p.marks));
    for (int pose = 0; pose < 6; pose++) {
        const double turn[3] = {3 + 0.1 * pose, 0.2, -0.1};
        fit_state s = {.pitch = 0.2, .roll = -0.03, .log_focal = 6.4, .log_scale = 0.05, .clothes = 0.7};
        s.body.pelvis_m[2] = 4;
        rotation_exp(turn, s.body.root, NULL);
        for (int i = 3; i < 3 * BODY_JOINTS; i++)
            s.body.bend[i / 3][i % 3] = 0.25 * random_normal((uint64_t)pose, (uint64_t)i);
        s.body.bend[1][0] -= 0.3 * pose;
        fit_cost(&p, &s, e);
        for (int u = 0; u < FIT_UNKNOWNS; u++) {
            double step[FIT_UNKNOWNS] = {0}, cost[2];
            for (int i = 0; i < 2; i++) {
                fit_state at = s;
                step[u] = i ? move : -move;
                body_state_move(&s.body, step, &at.body);
                at.pitch += step[FIT_PITCH], at.roll += step[FIT_ROLL];
                at.log_focal += step[FIT_FOCAL], at.log_scale += step[FIT_SCALE];
                at.clothes += step[FIT_CLOTHES];
                cost[i] = fit_cost(&p, &at, NULL);
            }
            const double slope = (cost[1] - cost[0]) / (2 * move);
            if (!(fabs(slope - 2 * e->b[u]) < 1e-4 * (1 + fabs(slope))))
                fail_msg("pose %d, unknown %d: slope %.6f, equations say %.6f", pose, u, slope, 2 * e->b[u]);
        }
    }
    body_points_free(p.marks);
    mem_free(p.mark_place);
    mem_free(p.mark_slope);
    mem_free(e);
}

/* Standing is usual, especially near the mean. A knee that bends forward is not. */
static void usual_poses_cost_less(void **state) {
    double x[FIT_POSE_NUMBERS], r[FIT_POSE_NUMBERS], mean, standing_cost, wrong;
    for (int i = 0; i < FIT_POSE_NUMBERS; i++) x[i] = FIT_POSE_MEAN_UNIT * fit_pose_kinds[0].mean[i];
    assert_ptr_equal(fit_pose_nearest(x, r, &mean), &fit_pose_kinds[0]);
    for (int i = 0; i < FIT_POSE_NUMBERS; i++) assert_true(fabs(r[i]) < 1e-9);
    assert_true(fabs(mean) < 1e-9);
    for (int i = 0; i < FIT_POSE_NUMBERS; i++)
        x[i] = i < FIT_POSE_NUMBERS - 2 ? fit_joints[fit_pose_joint[i / 3]].usual[i % 3] : 0;
    fit_pose_nearest(x, r, &standing_cost);
    assert_true(standing_cost > 0 && standing_cost < 60); /* 59 is the usual cost of as many numbers */
    x[9] = -0.5;
    fit_pose_nearest(x, r, &wrong);
    assert_true(wrong > standing_cost + 20);
}

static void front_is_told_from_back(void **state) {
    context *c = *state;
    for (int i = 0; i < 8; i++) {
        body_fit_result r;
        char name[32];
        scene w = standing;
        w.turn_rad = 2 * M_PI * i / 8;
        w.faults = true, w.noise_px = 1, w.pitch_rad = 0.1;
        snprintf(name, sizeof name, "turned by %d eighths", i);
        fit_and_check(c, name, &w, 0.055, &r);
        if (i % 4 != 2) assert_int_equal(r.from_behind, i > 2 && i < 6);
    }
}

static void other_poses(void **state) {
    context *c = *state;
    body_fit_result r;
    scene w = standing;
    w.hip = -1.5, w.knee = 1.5, w.turn_rad = 0.6, w.noise_px = 1, w.faults = true; /* on a chair */
    fit_and_check(c, "sitting", &w, 0.07, &r);
    assert_false(r.stands);
    w = standing;
    w.lift = -1.1, w.forward = -0.6, w.elbow = -1.9; /* arms crossed before the chest */
    fit_and_check(c, "arms crossed", &w, 0.06, &r);
    w.mask = false;
    fit_and_check(c, "without a mask", &w, 0.06, &r);
    w = standing;
    w.lift = 0.9;
    fit_and_check(c, "arms up", &w, 0.05, &r);
}

/* The picture ends below the knees: the landmarks there are outside and arbitrary. */
static void what_is_cut_off_stays_at_rest(void **state) {
    context *c = *state;
    static shot o;
    body_fit_result r;
    scene w = standing;
    w.distance_m = 2.4, w.rise_m = 0.75, w.focal_px = 700;
    take(c, &w, &o);
    for (int l = LANDMARK_LEFT_KNEE; l < LANDMARKS; l++) {
        landmark *mark = &o.person.landmark[l];
        mark->place_px[1] = SIDE + 30;
        mark->visible = 0.02f;
        mark->place_m[0] += 0.3f, mark->place_m[2] -= 0.4f;
    }
    assert_ok(c, body_fit(c, body, &o.in, &r));
    assert_true(r.cut_feet && !r.cut_head);
    double joint[BODY_JOINTS][3];
    joints_of(c, &r, joint);
    for (int j = 12; j < 20; j++)
        for (int k = 0; k < 2; k++)
            assert_true(fabs(joint[j][k] - joint[0][k] - o.joint[j][k] + o.joint[0][k]) < 0.06);
    for (int j = 4; j < 9; j++)
        if (j != 6)
            for (int k = 0; k < 3; k++) assert_true(fabsf(r.pose.poses_rad[3 * j + k]) < 0.6f);
    mem_free(o.mask.data);
}

static void threads_do_not_matter(void **state) {
    static shot o;
    body_fit_result r[2];
    context *one = NULL;
    const sherf_options options = {.threads = 1};
    assert_int_equal(sherf_context_create(&options, &one), SHERF_OK);
    scene w = standing;
    w.faults = true, w.noise_px = 3, w.turn_rad = 1;
    take(*state, &w, &o);
    assert_ok(one, body_fit(one, body, &o.in, &r[0]));
    assert_ok((context *)*state, body_fit(*state, body, &o.in, &r[1]));
    assert_memory_equal(&r[0].pose, &r[1].pose, sizeof r[0].pose);
    assert_memory_equal(&r[0].camera, &r[1].camera, sizeof r[0].camera);
    sherf_context_free(one);
    mem_free(o.mask.data);
}

static void a_focal_length_is_kept(void **state) {
    static shot o;
    body_fit_result r;
    scene w = standing;
    take(*state, &w, &o);
    o.in.focal_px = 1000;
    assert_ok((context *)*state, body_fit(*state, body, &o.in, &r));
    assert_true(fabsf(r.camera.K[0] - 1000) < 30);
    mem_free(o.mask.data);
}

static void bad_input_is_refused(void **state) {
    context *c = *state;
    static shot o;
    body_fit_result r;
    take(c, &standing, &o);
    o.person.landmark[3].place_m[1] = NAN;
    assert_int_equal(body_fit(c, body, &o.in, &r), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "finite"));
    mem_free(o.mask.data);
    take(c, &standing, &o);
    o.mask.width--;
    assert_int_equal(body_fit(c, body, &o.in, &r), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "mask"));
    mem_free(o.mask.data);
    take(c, &standing, &o);
    for (int l = 0; l < LANDMARKS; l++) o.person.landmark[l].place_px[0] = -500;
    assert_int_equal(body_fit(c, body, &o.in, &r), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "landmark"));
    mem_free(o.mask.data);
    for (int trial = 0; trial < 20; trial++) { /* noise: refused or a finite body */
        take(c, &standing, &o);
        for (int l = 0; l < LANDMARKS; l++)
            for (int k = 0; k < 3; k++) {
                uint64_t n = (uint64_t)(100 * trial + 3 * l + k);
                o.person.landmark[l].place_px[k % 2] = (float)(SIDE * random_uniform(8, n));
                o.person.landmark[l].place_m[k] = (float)random_normal(9, n);
            }
        sherf_status status = body_fit(c, body, &o.in, &r);
        assert_true(status == SHERF_OK || status == SHERF_MISMATCH);
        for (int i = 0; i < 72; i++) assert_true(isfinite(r.pose.poses_rad[i]));
        mem_free(o.mask.data);
    }
}

static void allocations_may_fail(void **state) {
    context *c = *state;
    static shot o;
    body_fit_result r;
    take(c, &standing, &o);
    size_t live = mem_live();
    for (long n = 0;; n++) {
        mem_fail_after(n);
        sherf_status status = body_fit(c, body, &o.in, &r);
        mem_fail_after(-1);
        assert_int_equal(mem_live(), live);
        if (status == SHERF_OK) {
            assert_true(n > 15);
            break;
        }
        assert_int_equal(status, SHERF_NO_MEMORY);
    }
    mem_free(o.mask.data);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(clothes_are_not_the_body),      cmocka_unit_test(priors_have_their_slopes),
        cmocka_unit_test(usual_poses_cost_less),         cmocka_unit_test(standing_people_stand),
        cmocka_unit_test(front_is_told_from_back),       cmocka_unit_test(other_poses),
        cmocka_unit_test(what_is_cut_off_stays_at_rest), cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(a_focal_length_is_kept),        cmocka_unit_test(bad_input_is_refused),
        cmocka_unit_test(allocations_may_fail)};
    return cmocka_run_group_tests(tests, open_body, close_body);
}
