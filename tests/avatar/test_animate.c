/* Tests of cameras that keep the person in the picture, and of animations from the first frame to the file.
 */
#include "walk.h"

#include "base/path.h"
#include "scene/scene.h"

typedef struct {
    context *c;
    sherf_body *body;
    sherf_model *model;
    sherf_observation *observation;
    sherf_avatar *avatar;
    sherf_motion *motion;
    int stop_after; /* frames; 0: never */
} fixture;

static void on_progress(void *user, const char *text, double done, double total) {
    fixture *f = user;
    if (f->stop_after && !strcmp(text, "frames") && done >= f->stop_after) sherf_cancel(f->c);
}

static int setup(void **state) {
    static fixture f;
    char folder[400], body[512], spec[512], clip_path[512];
    walk w;
    const sherf_options options = {
        .threads = 2, .precision = SHERF_PRECISION_FP32, .progress = on_progress, .user = &f};
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 2, .size_px = 64};
    if (sherf_context_create(&options, &f.c)) return -1;
    snprintf(folder, sizeof folder, "%s", test_path("people"));
    assert_ok(f.c, sherf_synth_tube(f.c, folder, &synth));
    snprintf(body, sizeof body, "%s/tubeman.safetensors", folder);
    assert_ok(f.c, sherf_body_load(f.c, body, &f.body));
    assert_ok(f.c, sherf_model_create(f.c, "small", 1, &f.model));
    snprintf(spec, sizeof spec, "thuman:%s#0/0/1", folder);
    assert_ok(f.c, sherf_observation_load(f.c, spec, &f.observation));
    assert_ok(f.c, sherf_avatar_create(f.c, f.model, f.body, f.observation, &f.avatar));
    walk_make(f.body, &w);
    snprintf(clip_path, sizeof clip_path, "%s", test_path("walk.bvh"));
    walk_write_bvh(&w, clip_path, &(bvh_style){walk_smpl_names, 24, 0.01});
    const sherf_motion_options o = {.body = f.body,
                                    .start = sherf_avatar_pose(f.avatar),
                                    .shapes = sherf_avatar_pose(f.avatar)->shapes,
                                    .blend_s = 0.2};
    assert_ok(f.c, sherf_motion_load(f.c, clip_path, &o, &f.motion));
    *state = &f;
    return 0;
}

static int teardown(void **state) {
    fixture *f = *state;
    sherf_motion_free(f->motion);
    sherf_avatar_free(f->avatar);
    sherf_observation_free(f->observation);
    sherf_model_free(f->model);
    sherf_body_free(f->body);
    sherf_context_free(f->c);
    return mem_live() == 0 ? 0 : -1;
}

/* Every vertex of every frame is in its picture; returns the used share of the picture's width or height. */
static double in_view(fixture *f, const sherf_camera *camera) {
    int n = sherf_body_vertex_count(f->body);
    float *v = malloc((size_t)n * 3 * sizeof *v), *uv = malloc((size_t)n * 2 * sizeof *uv);
    double used = 0;
    for (int i = 0; i < sherf_motion_frame_count(f->motion); i++) {
        sherf_pose p;
        sherf_motion_pose(f->motion, i, &p);
        assert_ok(f->c, camera_check(f->c, &camera[i]));
        assert_ok(f->c, sherf_body_pose(f->c, f->body, &p, v, NULL));
        camera_project(&camera[i], n, v, uv, NULL);
        double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
        for (int k = 0; k < 2 * n; k++)
            low[k % 2] = fmin(low[k % 2], uv[k]), high[k % 2] = fmax(high[k % 2], uv[k]);
        assert_true(low[0] >= 0 && low[1] >= 0 && high[0] < camera[i].width_px &&
                    high[1] < camera[i].height_px);
        used = fmax(used,
                    fmax((high[0] - low[0]) / camera[i].width_px, (high[1] - low[1]) / camera[i].height_px));
    }
    free(v);
    free(uv);
    return used;
}

static void cameras(void **state) {
    fixture *f = *state;
    int n = sherf_motion_frame_count(f->motion);
    assert_int_equal(n, WALK_FRAMES + 4);
    sherf_camera *k = malloc((size_t)n * sizeof *k);
    for (int kind = SHERF_CAMERA_FIXED; kind <= SHERF_CAMERA_ORBITING; kind++)
        for (int wide = 0; wide < 2; wide++) {
            const sherf_animate_options o = {.camera = (sherf_camera_path)kind,
                                             .width_px = wide ? 160 : 60,
                                             .height_px = wide ? 70 : 90,
                                             .turn_s = 1};
            assert_ok(f->c, sherf_animate_cameras(f->c, f->avatar, f->body, f->motion, &o, k));
            assert_int_equal(k[0].width_px, o.width_px);
            double used = in_view(f, k);
            if (!(used > 0.5)) fail_msg("camera %d uses %.2f of the picture", kind, used);
            bool still = !memcmp(&k[0], &k[n - 1], sizeof *k),
                 same_way = !memcmp(k[0].R, k[n - 1].R, sizeof k->R);
            assert_int_equal(still, kind == SHERF_CAMERA_FIXED);
            assert_int_equal(same_way, kind != SHERF_CAMERA_ORBITING);
        }
    /* one turn per second: after half a second the camera looks the other way and is still level */
    const sherf_animate_options orbit = {.camera = SHERF_CAMERA_ORBITING, .turn_s = 0.5, .aimed = 1};
    assert_ok(f->c, sherf_animate_cameras(f->c, f->avatar, f->body, f->motion, &orbit, k));
    for (int a = 0; a < 3; a++) assert_float_equal(k[0].R[6 + a], -k[5].R[6 + a], 1e-4);
    const sherf_animate_options own = {.camera = SHERF_CAMERA_OBSERVATION};
    assert_ok(f->c, sherf_animate_cameras(f->c, f->avatar, f->body, f->motion, &own, k));
    assert_memory_equal(&k[3], sherf_avatar_camera(f->avatar), sizeof *k);
    const sherf_animate_options bad = {.aimed = 1, .elevation_rad = 2};
    assert_int_equal(sherf_animate_cameras(f->c, f->avatar, f->body, f->motion, &bad, k), SHERF_BAD_ARGUMENT);
    free(k);
}

/* The picture's own view of the picture's own pose looks from where the picture was taken. */
static void aims_as_the_picture(void **state) {
    fixture *f = *state;
    sherf_camera *k = malloc((size_t)sherf_motion_frame_count(f->motion) * sizeof *k);
    assert_ok(f->c, sherf_animate_cameras(f->c, f->avatar, f->body, f->motion, NULL, k));
    const sherf_camera *theirs = sherf_avatar_camera(f->avatar);
    double along = 0;
    for (int a = 0; a < 3; a++) along += k[0].R[6 + a] * theirs->R[6 + a];
    assert_true(along >
                cos(12 * M_PI /
                    180)); /* it looks at the middle of the motion; the picture's camera looks at the body */
    assert_float_equal(k[0].K[4] / k[0].height_px, theirs->K[4] / theirs->height_px, 1e-4);
    free(k);
}

static void files(void **state) {
    fixture *f = *state;
    static const char *const name[] = {"a.mp4", "a.webm", "a.gif", "frames"};
    int n = sherf_motion_frame_count(f->motion);
    for (int i = 0; i < 4; i++) {
        const sherf_animate_options o = {.width_px = 32, .transparent = i > 0, .render = {.samples = 8}};
        sherf_animate_result r;
        const char *path = test_path(name[i]);
        assert_ok(f->c, sherf_animate(f->c, f->avatar, f->body, f->motion, &o, path, &r));
        assert_int_equal(r.frames, n);
        assert_true(r.frame_ms > 0 && r.points > 0);
        if (i < 3) assert_true(path_is_file(path));
    }
    char last[600];
    snprintf(last, sizeof last, "%s/frame_%04d.png", test_path("frames"), n - 1);
    assert_true(path_is_file(last));
    const sherf_animate_options mp4 = {.transparent = 1};
    assert_int_equal(sherf_animate(f->c, f->avatar, f->body, f->motion, &mp4, test_path("b.mp4"), NULL),
                     SHERF_UNSUPPORTED);
    assert_int_equal(sherf_animate(f->c, f->avatar, f->body, f->motion, NULL, "/no/such/b.mp4", NULL),
                     SHERF_WRITE_FAILED);
}

/* Stopped midway, the frames so far are a complete file. */
static void stopped(void **state) {
    fixture *f = *state;
    const sherf_animate_options o = {.width_px = 32, .render = {.samples = 8}};
    const char *path = test_path("stopped.mp4");
    sherf_animate_result r;
    f->stop_after = 5;
    assert_int_equal(sherf_animate(f->c, f->avatar, f->body, f->motion, &o, path, &r), SHERF_CANCELLED);
    assert_non_null(strstr(f->c->message, "stopped after 5 of 16 frames"));
    f->stop_after = 0;
    sherf_cancel_reset(f->c);
    assert_int_equal(r.frames, 5);
    assert_true(path_is_file(path));
    /* before the first frame there is nothing to keep */
    sherf_cancel(f->c);
    path = test_path("none.mp4");
    assert_int_equal(sherf_animate(f->c, f->avatar, f->body, f->motion, &o, path, &r), SHERF_CANCELLED);
    sherf_cancel_reset(f->c);
    assert_int_equal(r.frames, 0);
    assert_false(path_is_file(path));
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(cameras), cmocka_unit_test(aims_as_the_picture),
                                       cmocka_unit_test(files), cmocka_unit_test(stopped)};
    return cmocka_run_group_tests(tests, setup, teardown);
}
