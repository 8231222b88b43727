/* Tests of videos to motions: the parts on synthetic paths, and everything on a person with a known body who
 * is moved across the picture. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "open_body.h"
#include "estimate/clip_inside.h"

/* ---- least squares of a path ---- */

static void steady_paths_stay(void **state) {
    enum { N = 30 };
    context *c = *state;
    double given[N][2], weight[N], out[N][2];
    for (int i = 0; i < N; i++) {
        weight[i] = i < 10 || i > 16; /* a gap */
        given[i][0] = weight[i] > 0 ? 3 - 0.25 * i : 1000;
        given[i][1] = weight[i] > 0 ? 0.5 * i : -1000;
    }
    const path_problem p = {.count = N, .dims = 2, .stiffness = 50, .weight = weight, .value = given[0]};
    assert_ok(c, path_solve(c, &p, out[0]));
    for (int i = 0; i < N; i++) {
        assert_true(fabs(out[i][0] - (3 - 0.25 * i)) < 1e-6);
        assert_true(fabs(out[i][1] - 0.5 * i) < 1e-6);
    }
}

/* A swing at the end of the band is halved, a slow one is kept, and steps are followed where they pull hard.
 */
static void bands_and_steps(void **state) {
    enum { N = 400 };
    context *c = *state;
    static double given[N], weight[N], out[N], pull[N], step[N];
    const double fps = 30, hz[] = {0.5, 3, 12}, keeps[] = {0.999, 0.5, 0.004};
    for (int k = 0; k < 3; k++) {
        double max = 0;
        for (int i = 0; i < N; i++) given[i] = sin(2 * M_PI * hz[k] * i / fps), weight[i] = 1;
        const path_problem p = {
            .count = N, .dims = 1, .stiffness = path_stiffness(fps, 3), .weight = weight, .value = given};
        assert_ok(c, path_solve(c, &p, out));
        for (int i = N / 4; i < 3 * N / 4; i++) max = fmax(max, fabs(out[i]));
        if (fabs(max - keeps[k]) > (k == 1 ? 0.02 : 0.01)) fail_msg("%g Hz: %g is kept", hz[k], max);
    }
    for (int i = 0; i < N; i++) given[i] = 0, weight[i] = 1e-6, pull[i] = 100, step[i] = 0.01;
    weight[0] = 100;
    const path_problem p = {
        .count = N, .dims = 1, .weight = weight, .value = given, .pull = pull, .step = step};
    assert_ok(c, path_solve(c, &p, out));
    assert_true(fabs(out[N / 2] - 0.01 * (N / 2)) < 0.03);
}

/* ---- front and back ---- */

static void look_like(clip_frame *f, double yaw, bool wrong) {
    for (int side = 0; side < 2; side++)
        for (int l = LANDMARK_LEFT_SHOULDER; l <= LANDMARK_LEFT_HIP;
             l += LANDMARK_LEFT_HIP - LANDMARK_LEFT_SHOULDER) {
            landmark *mark = &f->landmark[l + (wrong ? 1 - side : side)];
            const double out = side ? -0.15 : 0.15;
            mark->place_m[0] = (float)(out * cos(yaw));
            mark->place_m[2] = (float)(out * sin(yaw) * (wrong ? -1 : 1));
            mark->place_px[0] =
                (float)(side ? 100 : 200); /* left and right stay where they are in the picture */
        }
}

static void front_and_back(void **state) {
    enum { N = 60 };
    context *c = *state;
    clip_track t = {.count = N, .fps = 30};
    int repaired;
    t.frame = mem_zero(c, N, sizeof *t.frame);
    for (int i = 0; i < N; i++) {
        if (i == 40) continue; /* not seen */
        t.frame[i] = mem_zero(c, 1, sizeof *t.frame[i]);
        look_like(t.frame[i], 0.05 * i, i < 3 || (i >= 6 && i < 13) || i == 50);
    }
    assert_ok(c, clip_repair(c, &t, &repaired));
    assert_int_equal(repaired, 11);
    for (int i = 0; i < N; i++) {
        if (i == 40) continue;
        const landmark *l = t.frame[i]->landmark;
        assert_int_equal(l[LANDMARK_LEFT_HIP].place_px[0], 200);
        const double yaw =
            atan2((double)(l[LANDMARK_LEFT_HIP].place_m[2]), (double)l[LANDMARK_LEFT_HIP].place_m[0]);
        assert_true(fabs(remainder(yaw - 0.05 * i, 2 * M_PI)) < 1e-5);
    }
    clip_track_free(&t);
}

/* ---- cuts ---- */

static double wobble(int i, int k) {
    return random_normal(7, (uint64_t)(1000 * i + k));
}

enum { SHOTS_FRAMES = 90, SHOTS_SIDE = 48 };

/* Frame i of a scene: a pattern of its own, which `pan` moves, brightened, with noise. */
static void draw_scene(clip_track *t, int i, int scene, double pan, int light) {
    static uint8_t data[SHOTS_SIDE * SHOTS_SIDE * 3];
    const image_u8 picture = {.width = SHOTS_SIDE, .height = SHOTS_SIDE, .data = data};
    for (int at = 0; at < SHOTS_SIDE * SHOTS_SIDE; at++)
        for (int k = 0; k < 3; k++) {
            const double x = at % SHOTS_SIDE + pan, y = at / SHOTS_SIDE;
            const double wave = 60 * sin(0.2 * (scene + 1) * x + k) + 30 * cos(0.3 * y + 2 * scene);
            const double shade = 110 + wave + light + 4 * wobble(i, at);
            data[3 * at + k] = (uint8_t)fmin(fmax(shade, 0), 255);
        }
    clip_thumbnail_make(&picture, &t->thumbnail[i]);
}

static void track_of_pictures(context *c, clip_track *t) {
    *t = (clip_track){.count = SHOTS_FRAMES, .fps = 30};
    t->frame = mem_zero(c, SHOTS_FRAMES, sizeof *t->frame);
    t->repeated = mem_zero(c, SHOTS_FRAMES, sizeof *t->repeated);
    t->thumbnail = mem_zero(c, SHOTS_FRAMES, sizeof *t->thumbnail);
    for (int i = 0; i < SHOTS_FRAMES; i++) {
        t->frame[i] = mem_zero(c, 1, sizeof **t->frame);
        t->frame[i]->score = (float)i;
    }
}

/* Three shots of 25, 40 and 25 frames: a picture that stands still, one without the person in its last 20
 * frames, and the one that is kept. */
static void the_longest_shot_is_kept(void **state) {
    context *c = *state;
    clip_track t;
    track_of_pictures(c, &t);
    for (int i = 0; i < SHOTS_FRAMES; i++)
        if (i > 0 && i < 25)
            t.thumbnail[i] = t.thumbnail[0];
        else
            draw_scene(&t, i, i < 25 ? 0 : i < 65 ? 1 : 2, 0, 0);
    for (int i = 45; i < 65; i++) {
        mem_free(t.frame[i]);
        t.frame[i] = NULL;
    }
    t.repeated[65] = true;
    assert_false(clip_cut_at(&t, 24, 25));
    assert_true(clip_cut_at(&t, 25, 26));
    assert_true(clip_cut_at(&t, 65, 66));
    mem_free(t.frame[3]);
    t.frame[3] = NULL; /* the last shot now shows the person in one frame more than the first */
    clip_keep_shot(&t);
    assert_int_equal(t.cuts, 2);
    assert_int_equal(t.start, 65);
    assert_int_equal(t.count, 25);
    assert_false(t.repeated[0]);
    for (int i = 0; i < t.count; i++) assert_int_equal(t.frame[i]->score, 65 + i);
    clip_track_free(&t);
}

/* A flash, a pan that begins at once and becomes brighter, and pictures that are held for five frames. */
static void no_cuts(void **state) {
    context *c = *state;
    clip_track t;
    track_of_pictures(c, &t);
    for (int i = 0; i < SHOTS_FRAMES; i++) {
        if (i >= 60 && i % 5) {
            t.thumbnail[i] = t.thumbnail[i - 1];
            continue;
        }
        draw_scene(&t, i, 0,
                   i < 40   ? 0
                   : i < 60 ? 3 * (i - 40)
                            : 60 + 1.6 * (i - 60),
                   i == 20 || i == 21 ? 120
                   : i > 40           ? i - 40
                                      : 0);
    }
    clip_keep_shot(&t);
    assert_int_equal(t.cuts, 0);
    assert_int_equal(t.start, 0);
    assert_int_equal(t.count, SHOTS_FRAMES);
    clip_track_free(&t);
}

/* ---- noise, gaps, the floor ---- */

/* Somebody who swings an arm and moves sideways before a camera that looks down. */
static void noise_and_gaps(void **state) {
    enum { N = 60 };
    context *c = *state;
    const double pitch = 0.2, high_m = 1.5, noise_rad = 0.08;
    sherf_motion *motion;
    body_fit_result known = {.pitch_rad = pitch};
    clip_track t = {.count = N, .fps = 30, .width = 512, .height = 512};
    t.frame = mem_zero(c, N, sizeof *t.frame);
    t.repeated = mem_zero(c, N, sizeof *t.repeated);
    skeleton bones;
    skeleton_of(body, known.pose.shapes, &bones);
    for (int i = 0; i < N; i++) {
        if (i % 20 >= 16) continue;
        clip_frame *f = t.frame[i] = mem_zero(c, 1, sizeof *f);
        f->fitted = true;
        for (int l = 0; l < LANDMARKS; l++) f->landmark[l].visible = f->landmark[l].present = 1;
        sherf_pose_identity(&f->fit.pose);
        for (int j = 0; j < 72; j++) f->fit.pose.poses_rad[j] = (float)(noise_rad * wobble(i, j));
        f->fit.pose.poses_rad[3 * 16 + 2] += (float)(-0.6 + 0.5 * sin(2 * M_PI * i / 30));
        const float R[9] = {
            1, 0, 0, 0, (float)-cos(pitch), (float)sin(pitch), 0, (float)-sin(pitch), (float)-cos(pitch)};
        memcpy(f->fit.camera.R, R, sizeof R);
        const double place[3] = {0.04 * i, 1.0 - high_m, -4 + 0.05 * wobble(i, 100)};
        for (int a = 0; a < 3; a++) {
            f->fit.pose.Th_m[a] = (float)(place[a] - bones.rest_m[0][a]);
            f->fit.camera.T_m[a] = 0;
        }
    }
    assert_ok(c, clip_settle(c, body, &t, 0, N - 5, &known, 1, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), N - 4);
    double off = 0, lowest = 0;
    for (int i = 0; i < N - 4; i++) {
        sherf_pose p;
        double joint[BODY_JOINTS][3];
        static const double up[3] = {0, 1, 0};
        sherf_motion_pose(motion, i, &p);
        skeleton_joints(&bones, (const float(*)[4])motion->clip.turn[i], motion->clip.pelvis_m[i], joint);
        off += fabs((double)p.poses_rad[3 * 16 + 2] - (-0.6 + 0.5 * sin(2 * M_PI * i / 30))) / (N - 4);
        lowest = fmax(lowest, fabs(skeleton_lowest(&bones, (const float(*)[4])motion->clip.turn[i],
                                                   motion->clip.pelvis_m[i], up)));
        /* the sideways motion is kept in spite of gaps; 5 cm of noise in the distance become 2 cm */
        assert_true(fabs((double)(motion->clip.pelvis_m[i][0] - motion->clip.pelvis_m[0][0]) - 0.04 * i) <
                    0.04);
        assert_true(fabs((double)(motion->clip.pelvis_m[i][2] - motion->clip.pelvis_m[0][2])) < 0.06);
    }
    if (off > 0.045) fail_msg("the arm is off by %.3f rad, after noise of %.3f", off, noise_rad);
    if (lowest > 0.03) fail_msg("%.3f m off the floor", lowest);
    sherf_motion_free(motion);
    clip_track_free(&t);
}

/* ---- all of it ---- */

enum { SIDE = 512, FRAMES = 12, SHIFT_PX = 14 };

static void add_person(context *c, sherf_video *v, sherf_image *image, const sherf_observation *o, int shift,
                       bool there, float wall) {
    for (int at = 0; at < SIDE * SIDE; at++) {
        const int x = at % SIDE - shift, from = at - shift;
        const bool in = there && x >= 0 && x < SIDE && o->mask[from] > 0;
        for (int k = 0; k < 3; k++)
            image->data[3 * at + k] = in ? o->image.data[3 * from + k] : wall - 0.03f * (float)k;
    }
    assert_ok(c, sherf_video_add(c, v, image));
}

/* The person in front of a light wall, SHIFT_PX further right in every frame; frames 5 and 6 show only the
 * wall, and the detector runs again 0.2 s after the first of them. Before that comes a shot of `other` frames
 * in which the person stands far to the right of a darker wall. */
static void write_clip(context *c, const char *path, const sherf_observation *o, bool empty, int other) {
    sherf_video *v;
    sherf_image image = {SIDE, SIDE, 3, mem_alloc(c, SIDE * SIDE * 3, sizeof(float))};
    assert_int_equal(o->image.width, SIDE);
    assert_ok(c, sherf_video_open(c, path, SIDE, SIDE, 20, &v));
    for (int i = 0; i < other; i++) add_person(c, v, &image, o, 100, true, 0.5f);
    for (int i = 0; i < FRAMES; i++)
        add_person(c, v, &image, o, SHIFT_PX * (i - FRAMES / 2), !empty && i != 5 && i != 6, 0.8f);
    assert_ok(c, sherf_video_close(c, v));
    mem_free(image.data);
}

static void joints_camera(context *c, const sherf_pose *pose, const float R[9], double out[BODY_JOINTS][3]) {
    posed_body *p;
    assert_ok(c, posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &p));
    for (int j = 0; j < BODY_JOINTS; j++) {
        double world[3];
        for (int a = 0; a < 3; a++) {
            world[a] = 0;
            for (int b = 0; b < 3; b++)
                world[a] +=
                    (double)pose->R[3 * a + b] * (double)(p->joints_smpl[j][b] - p->joints_smpl[0][b]);
        }
        for (int a = 0; a < 3; a++) {
            out[j][a] = 0;
            for (int b = 0; b < 3; b++) out[j][a] += (double)R[3 * a + b] * world[b];
        }
    }
    posed_body_free(p);
}

static double leg_length(const double joint[BODY_JOINTS][3]) {
    double sum = 0;
    for (int j = 1; j <= 5; j++) {
        double squared = 0;
        if (j == 3) continue;
        for (int k = 0; k < 3; k++) squared += pow(joint[j + 3][k] - joint[j][k], 2);
        sum += sqrt(squared); /* hip to knee, knee to ankle */
    }
    return sum;
}

/* The mean distance in metres between a clip's joints and the observation's. truth and found: those of the
 * last frame, in the camera's frame. */
static double joints_off(context *c, const sherf_observation *o, const sherf_motion *motion,
                         const sherf_clip_facts *facts, double truth[BODY_JOINTS][3],
                         double found[BODY_JOINTS][3]) {
    const double cp = cos(facts->pitch_rad), sp = sin(facts->pitch_rad), cr = cos(facts->roll_rad),
                 sr = sin(facts->roll_rad);
    const float R[9] = {(float)cr, (float)(sr * cp),  (float)(-sr * sp),
                        (float)sr, (float)(-cr * cp), (float)(cr * sp),
                        0,         (float)-sp,        (float)-cp};
    double off = 0;
    sherf_pose pose;
    joints_camera(c, &o->pose, o->camera.R, truth);
    for (int i = 0; i < FRAMES; i++) {
        sherf_motion_pose(motion, i, &pose);
        joints_camera(c, &pose, R, found);
        /* a person moved across the picture turns with the ray */
        const double turn = SHIFT_PX * (i - FRAMES / 2) / facts->focal_px;
        for (int j = 1; j < BODY_JOINTS; j++) {
            const double *t = truth[j], x = t[0] * cos(turn) + t[2] * sin(turn),
                         z = t[2] * cos(turn) - t[0] * sin(turn);
            off += sqrt(pow(found[j][0] - x, 2) + pow(found[j][1] - t[1], 2) + pow(found[j][2] - z, 2)) /
                   (FRAMES * (BODY_JOINTS - 1));
        }
    }
    return off;
}

static void a_known_person(void **state) {
    context *c = *state;
    sherf_dataset *d;
    sherf_observation *o;
    sherf_motion *motion;
    sherf_clip_facts facts;
    pose_networks *n;
    char path[512], moves[512];
    snprintf(path, sizeof path, "%s", test_path("clip.mp4"));
    snprintf(moves, sizeof moves, "%s", test_path("moves.npz"));
    assert_ok(c, sherf_dataset_open(c, "thuman:../assets/demo", &d));
    assert_ok(c, sherf_dataset_observation(c, d, 0, 2, 0, &o));
    write_clip(c, path, o, false, 0);
    assert_ok(
        c, sherf_estimate_clip(c, "../assets/models/blazepose.safetensors", body, path, NULL, moves, &facts));
    assert_int_equal(facts.frames, FRAMES);
    assert_int_equal(facts.people, 1);
    assert_int_equal(facts.filled, 4);
    assert_int_equal(facts.left_out, 0);
    assert_int_equal(facts.cuts, 0);
    assert_true(fabs(facts.start_s) < 1e-9);
    assert_int_equal(facts.repaired, 0);
    assert_true(facts.landmarks < 0.02);
    assert_ok(c,
              sherf_motion_load(c, moves, &(sherf_motion_options){.body = body, .their_shape = 1}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), FRAMES);
    assert_true(fabs(sherf_motion_fps(motion) - 20) < 0.01);
    double truth[BODY_JOINTS][3], found[BODY_JOINTS][3];
    const double off = joints_off(c, o, motion, &facts, truth, found);
    sherf_pose first, last;
    print_message("joints are off by %.1f mm\n", 1000 * off);
    if (off > 0.08) fail_msg("joints are off by %.0f mm", 1000 * off);
    sherf_motion_pose(motion, 0, &first);
    sherf_motion_pose(motion, FRAMES - 1, &last);
    double z = (double)o->camera.T_m[2]; /* approximately the pelvis's distance */
    for (int k = 0; k < 3; k++) z += (double)o->camera.R[6 + k] * (double)o->pose.Th_m[k];
    /* a person's size cannot be seen: an error in it is also an error in the distance walked */
    const double larger = leg_length(found) / leg_length(truth),
                 went = (double)(last.Th_m[0] - first.Th_m[0]) / larger,
                 wanted = SHIFT_PX * (FRAMES - 1) * z / (double)o->camera.K[0];
    assert_true(fabs(larger - 1) < 0.25);
    if (fabs(went / wanted - 1) > 0.1) fail_msg("went %.2f m, not %.2f", went, wanted);
    sherf_motion_free(motion);
    assert_ok(c, pose_networks_load(c, "../assets/models/blazepose.safetensors", &n));
    write_clip(c, path, o, true, 0);
    assert_int_equal(clip_estimate(c, n, body, path, &(sherf_clip_options){.fps = 2}, &motion, NULL),
                     SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "nobody is seen"));
    assert_null(motion);
    write_clip(c, path, o, false, 3);
    assert_ok(c, clip_estimate(c, n, body, path, &(sherf_clip_options){0}, &motion, &facts));
    assert_int_equal(facts.cuts, 1);
    assert_int_equal(facts.frames, FRAMES);
    assert_int_equal(facts.left_out, 3);
    assert_int_equal(facts.filled, 4);
    assert_true(fabs(facts.start_s - 3 / 20.0) < 1e-9);
    assert_true(facts.landmarks < 0.02);
    sherf_motion_free(motion);
    pose_networks_free(n);
    sherf_observation_free(o);
    sherf_dataset_free(d);
}

static void bad_options(void **state) {
    context *c = *state;
    sherf_motion *motion;
    assert_int_equal(clip_estimate(c, NULL, body, "x.mp4", &(sherf_clip_options){.person = 8}, &motion, NULL),
                     SHERF_BAD_ARGUMENT);
    assert_int_equal(clip_estimate(c, NULL, body, "x.mp4", &(sherf_clip_options){.fps = NAN}, &motion, NULL),
                     SHERF_BAD_ARGUMENT);
    assert_int_equal(
        clip_estimate(c, NULL, body, test_path("absent"), &(sherf_clip_options){0}, &motion, NULL),
        SHERF_NO_FILE);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(steady_paths_stay),        cmocka_unit_test(bands_and_steps),
        cmocka_unit_test(front_and_back),           cmocka_unit_test(noise_and_gaps),
        cmocka_unit_test(the_longest_shot_is_kept), cmocka_unit_test(no_cuts),
        cmocka_unit_test(a_known_person),           cmocka_unit_test(bad_options),
    };
    return cmocka_run_group_tests(tests, open_body, close_body);
}
