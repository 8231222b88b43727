/* Shared by the tests of motion formats: files that contain the walk, and files that are refused. */
#ifndef TEST_MOTION_FORMATS_H
#define TEST_MOTION_FORMATS_H
#include "walk.h"

#include "data/pickle_write.h"

/* Checks that the file contains the walk, to a millimetre at every vertex, and that its line says so. */
static inline void assert_walk(const walk_fixture *f, const char *path, const sherf_motion_options *options,
                               double fps, const char *part, const char *other) {
    sherf_motion_options o = options ? *options : (sherf_motion_options){0};
    sherf_motion *motion;
    o.body = f->body;
    assert_ok(f->c, sherf_motion_load(f->c, path, &o, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), WALK_FRAMES);
    assert_float_equal(sherf_motion_fps(motion), fps, 1e-4);
    const char *text = sherf_motion_description(motion);
    if (!strstr(text, part) || !strstr(text, other)) fail_msg("\"%s\": no %s, or no %s", text, part, other);
    for (int i = 0; i < WALK_FRAMES; i++) {
        sherf_pose p;
        sherf_motion_pose(motion, i, &p);
        double off = walk_distance(f->c, f->body, &p, &f->walk.pose[i]);
        if (!(off < 1e-3)) fail_msg("%s, frame %d: a vertex is %g m off", path, i, off);
    }
    sherf_motion_free(motion);
}

static inline void refused(const walk_fixture *f, const char *path, const sherf_motion_options *o,
                           sherf_status status, const char *part) {
    sherf_motion *motion;
    f->c->message[0] = 0;
    sherf_status got = sherf_motion_load(f->c, path, o, &motion);
    if (got != status) fail_msg("status %d, not %d: %s", (int)got, (int)status, f->c->message);
    assert_null(motion);
    if (!strstr(f->c->message, part)) fail_msg("\"%s\" does not say \"%s\"", f->c->message, part);
}

/* ---- arrays of the walk ---- */
typedef struct {
    float whole[WALK_FRAMES][165], root[WALK_FRAMES][3], body[WALK_FRAMES][69], trans[WALK_FRAMES][3],
        smpl[WALK_FRAMES][72], transx[WALK_FRAMES][3]; /* transx: for SMPL-X, whose pelvis is lower at rest */
} arrays;

static inline void arrays_of(const walk *w, const double C[9], arrays *a) {
    static const float offset[3] = {0.0031f + 0.0018f, -0.3514f + 0.2233f, 0.0120f - 0.0282f};
    memset(a, 0, sizeof *a);
    for (int i = 0; i < WALK_FRAMES; i++) {
        walk_in(w, i, C, a->root[i], a->trans[i]);
        for (int k = 0; k < 3; k++) a->transx[i][k] = a->trans[i][k] - offset[k];
        memcpy(a->body[i], w->pose[i].poses_rad + 3, sizeof a->body[i]);
        memcpy(a->smpl[i], a->root[i], sizeof a->root[i]);
        memcpy(a->smpl[i] + 3, a->body[i], sizeof a->body[i]);
        memcpy(a->whole[i], a->smpl[i], 66 * sizeof(float));
    }
}

static inline void floats(pickle_writer *w, const char *key, int count, const float *data) {
    pickle_string(w, key);
    pickle_floats(w, 2, (const int[]){WALK_FRAMES, count}, data);
}

/* Joint positions determine everything but twist: the joints come out where they were. */
static inline void assert_joints_at(const walk_fixture *f, const char *path, const sherf_motion *motion,
                                    const double at[WALK_FRAMES][22][3]) {
    for (int i = 0; i < WALK_FRAMES; i++) {
        double now[BODY_JOINTS][3];
        skeleton_joints(&f->walk.skeleton, (const float(*)[4])motion->clip.turn[i], motion->clip.pelvis_m[i],
                        now);
        for (int j = 0; j < 22; j++)
            for (int k = 0; k < 3; k++)
                if (!(fabs(now[j][k] - at[i][j][k]) < 2e-3))
                    fail_msg("%s: frame %d, joint %d is %g m off", path, i, j, now[j][k] - at[i][j][k]);
    }
}

static inline void assert_joints(const walk_fixture *f, const char *path, const double at[WALK_FRAMES][22][3],
                                 const char *part, const char *other) {
    sherf_motion *motion;
    assert_ok(f->c, sherf_motion_load(f->c, path, &(sherf_motion_options){.body = f->body}, &motion));
    assert_int_equal(sherf_motion_frame_count(motion), WALK_FRAMES);
    const char *text = sherf_motion_description(motion);
    if (!strstr(text, part) || !strstr(text, other)) fail_msg("\"%s\": no %s, or no %s", text, part, other);
    assert_joints_at(f, path, motion, at);
    sherf_motion_free(motion);
}

#endif
