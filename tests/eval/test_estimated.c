/* Tests of evaluation with estimates: errors of bent skeletons, and the mapping of the truth. A true body and
 * camera in another world score like the truth. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "eval/protocol.h"
#include "tube_people.h"

enum { SIDE = 48, PIXELS = SIDE * SIDE };
static char root[512];
static tube_people people;
static body_model *body;

static int make_data(void **state) {
    context *c = test_context();
    snprintf(root, sizeof root, "%s", test_path("people"));
    const sherf_synth_options synth = {.people = 2, .poses = 3, .views = 6, .size_px = SIDE, .seed = 5};
    sherf_status status = tube_people_make(c, root, &synth, &people);
    if (!status) status = body_load(c, people.body, &body);
    sherf_context_free(c);
    return status != SHERF_OK;
}

static int free_data(void **state) {
    sherf_body_free(body);
    return mem_live() != 0;
}

/* ---- errors ---- */

static void turn_points(int n, const double axis[3], double angle, double scale, const double shift[3],
                        const double (*x)[3], double (*y)[3]) {
    const float a[3] = {(float)(angle * axis[0]), (float)(angle * axis[1]), (float)(angle * axis[2])};
    float R[9];
    rodrigues(a, R);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            y[i][k] = shift[k];
            for (int m = 0; m < 3; m++) y[i][k] += scale * (double)R[3 * k + m] * x[i][m];
        }
}

static void similarities_are_taken_out(void **state) {
    double x[12][3], y[12][3];
    for (int trial = 0; trial < 20; trial++) {
        uint64_t key = (uint64_t)trial;
        for (int i = 0; i < 36; i++) x[i / 3][i % 3] = random_normal(key, (uint64_t)i);
        double axis[3], length = 0, shift[3] = {0.4, -3, 2};
        for (int k = 0; k < 3; k++)
            axis[k] = random_normal(key, 50 + (uint64_t)k), length += axis[k] * axis[k];
        for (int k = 0; k < 3; k++) axis[k] /= sqrt(length);
        turn_points(12, axis, 0.16 * trial, 0.5 + 0.1 * trial, shift, (const double(*)[3])x, y);
        assert_true(procrustes_distance(12, (const double(*)[3])x, (const double(*)[3])y) < 1e-5);
        for (int i = 0; i < 12; i++) y[i][0] = -y[i][0]; /* no rotation turns a left hand into a right one */
        assert_true(procrustes_distance(12, (const double(*)[3])x, (const double(*)[3])y) > 0.1);
    }
    /* Two points, one of them off by d: with the scale free, half of it remains at each. */
    const double a[2][3] = {{0, 0, 0}, {0, 0, 0}}, b[2][3] = {{-1, 0, 0}, {1, 0, 0}};
    assert_true(fabs(procrustes_distance(2, a, b) - 1) < 1e-12);
}

static void skeleton(float out[BODY_JOINTS][3]) {
    static const float none[72], unit[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    context *c = test_context();
    posed_body *p;
    assert_ok(c, posed_body_create(c, body, none, none, unit, none, &p));
    memcpy(out, p->joints_smpl, sizeof p->joints_smpl);
    posed_body_free(p);
    sherf_context_free(c);
}

static void axis_between(const float a[3], const float b[3], double out[3]) {
    double length = 0;
    for (int k = 0; k < 3; k++) out[k] = (double)b[k] - (double)a[k], length += out[k] * out[k];
    for (int k = 0; k < 3; k++) out[k] /= sqrt(length);
}

/* The body turned about one of its own axes: 0 left, 1 along the trunk, 2 forward. */
static void turned_about(int which, double angle, const float in[BODY_JOINTS][3], float out[BODY_JOINTS][3]) {
    double axis[3][3], x[BODY_JOINTS][3], y[BODY_JOINTS][3];
    const double shift[3] = {0.1, -0.2, 0.3}; /* position has no effect */
    float hips[3];
    for (int k = 0; k < 3; k++) hips[k] = 0.5f * (in[1][k] + in[2][k]);
    axis_between(hips, in[12], axis[1]);
    axis_between(in[2], in[1], axis[0]); /* the tube body's hips and shoulders are level */
    for (int k = 0; k < 3; k++)
        axis[2][k] =
            axis[0][(k + 1) % 3] * axis[1][(k + 2) % 3] - axis[0][(k + 2) % 3] * axis[1][(k + 1) % 3];
    for (int i = 0; i < 3 * BODY_JOINTS; i++) x[i / 3][i % 3] = (double)in[i / 3][i % 3];
    turn_points(BODY_JOINTS, axis[which], angle, 1, shift, (const double(*)[3])x, y);
    for (int i = 0; i < 3 * BODY_JOINTS; i++) out[i / 3][i % 3] = (float)y[i / 3][i % 3];
}

static void errors_are_what_was_done(void **state) {
    static const struct {
        int axis;
        double angle, lean, forward, turn;
    } done[] = {{0, 0, 0, 0, 0},     {0, 0.2, 0.2, 0.2, 0}, {0, -0.1, 0.1, -0.1, 0},
                {1, 0.5, 0, 0, 0.5}, {1, -2.8, 0, 0, 2.8},  {2, 0.15, 0.15, 0, 0}};
    float truth[BODY_JOINTS][3], bent[BODY_JOINTS][3];
    const double degree = M_PI / 180;
    pose_error e;
    skeleton(truth);
    for (size_t i = 0; i < COUNT_OF(done); i++) {
        turned_about(done[i].axis, done[i].angle, (const float(*)[3])truth, bent);
        pose_error_measure((const float(*)[3])truth, (const float(*)[3])bent, &e);
        assert_true(e.aligned_mm < 0.01);
        assert_true(fabs(e.lean_deg * degree - done[i].lean) < 1e-3);
        assert_true(fabs(e.forward_deg * degree - done[i].forward) < 1e-3);
        assert_true(fabs(e.turn_deg * degree - done[i].turn) < 1e-3);
        assert_int_equal(pose_error_wrong_way(&e), done[i].turn > 2);
        assert_true(i ? e.joints_mm > 20 : e.joints_mm < 1e-3);
        assert_true(isnan(e.overlap));
    }
    memcpy(bent, truth, sizeof bent);
    bent[20][1] += 0.23f; /* one wrist of 23 joints */
    pose_error_measure((const float(*)[3])truth, (const float(*)[3])bent, &e);
    assert_true(fabs(e.joints_mm - 10) < 1e-3 && e.aligned_mm > 1 && e.lean_deg < 1e-3);
    const uint8_t a[6] = {1, 1, 1, 0, 0, 0}, b[6] = {0, 255, 255, 255, 0, 0}, nothing[6] = {0};
    assert_true(mask_overlap(6, a, b) == 0.5 && mask_overlap(6, a, a) == 1 &&
                mask_overlap(6, nothing, a) == 0);
    assert_true(mask_overlap(6, nothing, nothing) == 1);
}

/* ---- the protocol ---- */

typedef struct {
    float world_rad[3], world_m[3]; /* camera and body move together into this world */
    float turn_rad[3], away_m; /* the body turns about its pelvis; it moves away along the camera's axis */
    bool own_pose;             /* novel views in the estimated pose */
    int lost, seen;            /* number of the picture in which nobody is found; pictures so far */
} bend;

static void product(const float a[9], const float b[9], float out[9]) {
    float m[9];
    for (int i = 0; i < 9; i++)
        m[i] = a[i / 3 * 3] * b[i % 3] + a[i / 3 * 3 + 1] * b[3 + i % 3] + a[i / 3 * 3 + 2] * b[6 + i % 3];
    memcpy(out, m, sizeof m);
}

static void apply(const float R[9], const float x[3], const float t[3], float out[3]) {
    float y[3];
    for (int k = 0; k < 3; k++) y[k] = R[3 * k] * x[0] + R[3 * k + 1] * x[1] + R[3 * k + 2] * x[2] + t[k];
    memcpy(out, y, sizeof y);
}

static void bend_body(context *c, const bend *b, const sherf_camera *camera, sherf_pose *pose) {
    float turn[9], pelvis[3], away[3], back[3];
    posed_body *p;
    assert_ok(c, posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p));
    apply(pose->R, p->joints_smpl[0], pose->Th_m, pelvis);
    posed_body_free(p);
    rodrigues(b->turn_rad, turn);
    for (int k = 0; k < 3; k++)
        back[k] = pose->Th_m[k] - pelvis[k], away[k] = pelvis[k] + b->away_m * camera->R[6 + k];
    apply(turn, back, away, pose->Th_m);
    product(turn, pose->R, pose->R);
}

/* Moves the body, x' = Q x + q, and the camera, which sees the same. */
static void move_world(const bend *b, sherf_camera *camera, sherf_pose *pose) {
    float Q[9], inverse[9], minus[3];
    rodrigues(b->world_rad, Q);
    for (int i = 0; i < 9; i++) inverse[i] = Q[i % 3 * 3 + i / 3];
    apply(Q, pose->Th_m, b->world_m, pose->Th_m);
    product(Q, pose->R, pose->R);
    product(camera->R, inverse, camera->R);
    for (int k = 0; k < 3; k++) minus[k] = -b->world_m[k];
    apply(camera->R, minus, camera->T_m, camera->T_m);
}

static sherf_status bent(context *c, void *state, const sherf_image *photo, const sherf_observation *truth,
                         sherf_observation **out) {
    bend *b = state;
    sherf_camera camera = truth->camera;
    sherf_pose pose = truth->pose;
    sherf_image mask = {truth->image.width, truth->image.height, 1, mem_alloc(c, PIXELS, sizeof(float))};
    assert_non_null(mask.data);
    assert_int_equal(photo->width, truth->image.width);
    *out = NULL;
    if (++b->seen == b->lost) {
        sherf_image_free(&mask);
        return SHERF_OK;
    }
    for (int i = 0; i < PIXELS; i++) mask.data[i] = truth->mask[i];
    if (b->away_m != 0 || b->turn_rad[1] != 0) bend_body(c, b, &camera, &pose);
    if (b->world_m[0] != 0) move_world(b, &camera, &pose);
    sherf_status status = sherf_observation_create(c, &truth->image, &mask, &camera, &pose, out);
    sherf_image_free(&mask);
    return status;
}

static sherf_eval_options options_of(void) {
    return (sherf_eval_options){.data = people.spec,
                                .people = "0-1",
                                .body = people.body,
                                .model = people.weights,
                                .observations = "0:4",
                                .poses = "0,2",
                                .views = "0:2:3",
                                .baselines = 1};
}

static void run(context *c, bend *b, sherf_scores *out) {
    sherf_eval_options o = options_of();
    const eval_estimator estimator = {bent, b};
    o.own_pose = b && b->own_pose;
    assert_ok(c, eval_run(c, &o, b ? &estimator : NULL, out));
}

static double apart(const sherf_score *a, const sherf_score *b) {
    assert_int_equal(a->count, b->count);
    return fmax(fabs(a->psnr - b->psnr), 100 * fabs(a->ssim - b->ssim));
}

static double all_apart(const sherf_scores *a, const sherf_scores *b) {
    double max = fmax(apart(&a->novel_view, &b->novel_view), apart(&a->novel_pose, &b->novel_pose));
    for (int i = 0; i < 2; i++) {
        max = fmax(max, apart(&a->mean_color[i], &b->mean_color[i]));
        max = fmax(max, apart(&a->painted_body[i], &b->painted_body[i]));
    }
    return max;
}

static void the_truth_in_another_world_scores_as_the_truth(void **state) {
    context *c = test_context();
    sherf_scores truth, same, moved;
    bend none = {0}, world = {.world_rad = {0.4f, -1.1f, 0.3f}, .world_m = {1.5f, -0.7f, 2}};
    run(c, NULL, &truth);
    assert_int_equal(truth.estimates.count, 0);
    run(c, &none, &same);
    assert_true(all_apart(&truth, &same) == 0);
    assert_int_equal(same.estimates.count, 2);
    assert_true(same.estimates.joints_mm < 1e-3 && same.estimates.overlap == 1);
    assert_null(strstr(truth.table, "estimated bodies"));
    assert_non_null(strstr(same.table, "estimated bodies"));
    run(c, &world, &moved);
    printf("another world: %.2g dB or per cent of SSIM apart\n", all_apart(&truth, &moved));
    assert_true(all_apart(&truth, &moved) > 0 && all_apart(&truth, &moved) < 0.02);
    assert_true(moved.estimates.joints_mm < 0.01 && moved.estimates.turn_deg < 0.01);
    sherf_free(truth.table);
    sherf_free(same.table);
    sherf_free(moved.table);
    sherf_context_free(c);
}

/* A body that is too far away is moved back by its pelvis; a turned body is not. In the true pose, where only
 * the avatar is wrong, less is lost. */
static void errors_cost_what_they_should(void **state) {
    context *c = test_context();
    sherf_scores truth, away, turned, posed;
    bend farther = {.away_m = 0.25f, .own_pose = true},
         round = {.turn_rad = {0, 0.6f, 0}, .world_m = {1, 0, 0}, .own_pose = true}, avatar = round;
    run(c, NULL, &truth);
    run(c, &farther, &away);
    run(c, &round, &turned);
    avatar.own_pose = false;
    run(c, &avatar, &posed);
    double painted = truth.painted_body[0].psnr;
    assert_true(away.estimates.joints_mm < 0.01 && away.estimates.turn_deg < 0.01);
    assert_true(fabs(turned.estimates.turn_deg - 0.6 * 180 / M_PI) < 1.5 && turned.estimates.joints_mm > 30);
    assert_true(turned.estimates.aligned_mm < 0.01 && turned.estimates.wrong_way == 0);
    printf("painted body: %.2f dB, too far away %.2f, turned %.2f, and in the true pose %.2f\n", painted,
           away.painted_body[0].psnr, turned.painted_body[0].psnr, posed.painted_body[0].psnr);
    assert_true(turned.painted_body[0].psnr < painted - 1 &&
                away.painted_body[0].psnr > turned.painted_body[0].psnr);
    assert_true(posed.painted_body[0].psnr > turned.painted_body[0].psnr + 0.5);
    assert_true(apart(&posed.painted_body[1], &turned.painted_body[1]) == 0);
    sherf_free(truth.table);
    sherf_free(away.table);
    sherf_free(turned.table);
    sherf_free(posed.table);
    sherf_context_free(c);
}

/* A target has the true pose and the estimated shape, and its pelvis is seen at the same place. */
static void poses_keep_the_pelvis(void **state) {
    context *c = test_context();
    sherf_dataset *data;
    sherf_observation *truth, *estimate;
    sherf_pose target, carried_to;
    sherf_camera camera, seen;
    posed_body *p;
    carried w;
    float a[3], b[3];
    bend world = {.world_rad = {0.4f, -1.1f, 0.3f}, .world_m = {1.5f, -0.7f, 2}};
    assert_ok(c, sherf_dataset_open(c, people.spec, &data));
    assert_ok(c, dataset_observation(c, data, 0, 0, 4, 0, &truth));
    assert_ok(c, bent(c, &world, &truth->image, truth, &estimate));
    estimate->pose.shapes[0] = 1.5f, estimate->pose.shapes[1] = -1;
    assert_ok(c, carried_create(c, body, truth, estimate, &w));
    assert_false(w.same);
    assert_ok(c, dataset_pose(c, data, 0, 2, &target));
    assert_ok(c, dataset_camera(c, data, 0, 1, &camera));
    assert_ok(c, carried_pose(c, &w, body, &target, false, &carried_to));
    carried_camera(&w, &camera, &seen);
    assert_memory_equal(carried_to.poses_rad, target.poses_rad, sizeof target.poses_rad);
    assert_memory_equal(carried_to.shapes, estimate->pose.shapes, sizeof target.shapes);
    for (int i = 0; i < 2; i++) {
        const sherf_pose *of = i ? &carried_to : &target;
        const sherf_camera *by = i ? &seen : &camera;
        float *out = i ? b : a;
        assert_ok(c, posed_body_create(c, body, of->poses_rad, of->shapes, of->R, of->Th_m, &p));
        apply(of->R, p->joints_smpl[0], of->Th_m, out);
        apply(by->R, out, by->T_m, out); /* in the target's camera */
        posed_body_free(p);
    }
    /* at the same pixel, with the same number of pixels per metre in the observed picture */
    assert_true(w.scale > 0.9 && w.scale < 1.1 && w.scale != 1);
    for (int k = 0; k < 3; k++) assert_true(fabs(w.scale * (double)a[k] - (double)b[k]) < 1e-5);
    assert_ok(c, carried_pose(c, &w, body, &truth->pose, true, &carried_to));
    assert_memory_equal(&carried_to, &estimate->pose, sizeof carried_to);
    sherf_observation_free(truth);
    sherf_observation_free(estimate);
    sherf_dataset_free(data);
    sherf_context_free(c);
}

static void pictures_without_anybody_are_counted(void **state) {
    context *c = test_context();
    sherf_scores s;
    char folder[600], path[700];
    bend once = {.lost = 1};
    sherf_eval_options o = options_of();
    const eval_estimator estimator = {bent, &once};
    snprintf(folder, sizeof folder, "%s/out", root);
    o.output = folder;
    assert_ok(c, eval_run(c, &o, &estimator, &s));
    assert_int_equal(s.novel_view.count, 2); /* of one person */
    assert_int_equal(s.estimates.count, 1);
    assert_int_equal(s.estimates.missed, 1);
    assert_non_null(strstr(s.table, "nobody found in 1"));
    document *d;
    snprintf(path, sizeof path, "%s/scores.json", folder);
    assert_ok(c, json_read(c, path, &d));
    const value *all = value_get(d->root, "estimates"), *each = value_get(all, "each");
    assert_int_equal(value_count(each), 1);
    assert_true(number(value_at(each, 0), "joints_mm") < 1e-3 &&
                number(value_get(all, "worst"), "overlap") == 1);
    assert_true(number(all, "missed") == 1);
    document_free(d);
    sherf_free(s.table);
    once = (bend){.lost = 1};
    o.people = "0";
    assert_int_equal(eval_run(c, &o, &estimator, &s), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "nobody was found"));
    sherf_context_free(c);
}

/* The photo includes the background, unlike the observation. */
static void photos_have_backgrounds(void **state) {
    context *c = test_context();
    sherf_dataset *data;
    sherf_observation *o;
    sherf_image photo;
    image_u8 image;
    char path[700];
    snprintf(path, sizeof path, "%s/tube_001/view03/000001.png", root);
    assert_ok(c, image_read(c, path, 3, &image));
    assert_ok(c, sherf_dataset_open(c, people.spec, &data));
    assert_ok(c, dataset_observation(c, data, 1, 1, 3, 0, &o));
    for (int i = 0; i < PIXELS; i++)
        if (!o->mask[i]) image.data[3 * i] = 200;
    assert_ok(c, png_write(c, path, SIDE, SIDE, 3, image.data));
    assert_ok(c, dataset_photo(c, data, 1, 1, 3, 0, &photo));
    for (int i = 0; i < PIXELS; i++) {
        assert_true(o->mask[i] || photo.data[3 * i] == 200 / 255.f);
        assert_true(!o->mask[i] || !memcmp(photo.data + 3 * i, o->image.data + 3 * i, 3 * sizeof(float)));
    }
    mem_free(image.data);
    sherf_image_free(&photo);
    sherf_observation_free(o);
    sherf_dataset_free(data);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(similarities_are_taken_out),
                                       cmocka_unit_test(errors_are_what_was_done),
                                       cmocka_unit_test(the_truth_in_another_world_scores_as_the_truth),
                                       cmocka_unit_test(errors_cost_what_they_should),
                                       cmocka_unit_test(poses_keep_the_pelvis),
                                       cmocka_unit_test(pictures_without_anybody_are_counted),
                                       cmocka_unit_test(photos_have_backgrounds)};
    return cmocka_run_group_tests(tests, make_data, free_data);
}
