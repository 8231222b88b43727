/* Bare arrays, and motions given by joint positions: HumanML3D's features and joints, MDM's results,
 * Motion-X. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/vector3.h"
#include "motion/source.h"

enum { JOINTS = 22, JOINTS_MAX = 55, FEATURES = 263, MOTION_X = 322 };
static const double humanml_fps = 20, motion_x_fps = 30;
static const int whole_joints[] = {24, 22, 52, 55, 53, 0};

static bool normalise(double v[3]) {
    const double length = sqrt(dot3(v, v));
    for (int k = 0; k < 3 && length > 1e-9; k++) v[k] /= length;
    return length > 1e-9;
}

/* The smallest rotation that takes the unit vector a to b. */
static void turn_between(const double a[3], const double b[3], float q[4]) {
    double axis[3], w = 1 + dot3(a, b);
    cross3(a, b, axis);
    if (w < 1e-9) { /* opposite: about any axis across */
        const double spare[3] = {a[1], a[2], a[0]};
        cross3(a, spare, axis);
        w = 0;
    }
    const double length = sqrt(w * w + dot3(axis, axis));
    q[0] = (float)(w / length);
    for (int k = 0; k < 3; k++) q[k + 1] = (float)(axis[k] / length);
}

/* ---- from joints' places to turns ---- */

/* Rows: left, up orthogonalised to it, front. */
static bool axes_of(const double left[3], const double up[3], double B[9]) {
    memcpy(B, left, 3 * sizeof *B);
    cross3(left, up, B + 6);
    if (!normalise(B) || !normalise(B + 6)) return false;
    cross3(B + 6, B, B + 3);
    return true;
}

/* The rotation of a joint that carries a left, a right and a middle joint. */
static bool carrier_turn(const double rest[][3], const double at[][3], int left, int right, int from, int to,
                         float q[4]) {
    double own[9], now[9], R[9], a[3], b[3], c[3], d[3];
    for (int k = 0; k < 3; k++) {
        a[k] = rest[left][k] - rest[right][k], b[k] = rest[to][k] - rest[from][k];
        c[k] = at[left][k] - at[right][k], d[k] = at[to][k] - at[from][k];
    }
    if (!axes_of(a, b, own) || !axes_of(c, d, now)) return false;
    for (int i = 0; i < 9; i++)
        R[i] = now[i / 3] * own[i % 3] + now[3 + i / 3] * own[3 + i % 3] + now[6 + i / 3] * own[6 + i % 3];
    quaternion_from_matrix(R, q);
    return true;
}

/* Pelvis and chest by the joints they carry, the others by their bones, without twist; end joints follow. */
static bool turns_from_joints(const skeleton *s, const double at[JOINTS][3], float (*turn)[4]) {
    static const int8_t end[JOINTS] = {0, 4,  5,  6,  7, 8,  9,  10, 11, 0, 0,
                                       0, 15, 16, 17, 0, 18, 19, 20, 21, 0, 0};
    float world[BODY_JOINTS][4];
    if (!carrier_turn(s->rest_m, at, 1, 2, 0, 3, world[0])) return false;
    memcpy(turn[0], world[0], sizeof world[0]);
    for (int j = 1; j < JOINTS; j++) {
        const int p = skeleton_parent[j];
        float back[4];
        double bone[3], now[3];
        memcpy(world[j], world[p], sizeof world[j]);
        if (j == 9 && !carrier_turn(s->rest_m, at, 16, 17, 9, 12, world[j])) return false;
        quaternion_inverse(world[p], back);
        if (end[j]) {
            for (int k = 0; k < 3; k++)
                bone[k] = s->rest_m[end[j]][k] - s->rest_m[j][k], now[k] = at[end[j]][k] - at[j][k];
            if (!normalise(bone) || !normalise(now)) return false;
            quaternion_rotate(back, now, now);
            turn_between(bone, now, turn[j]);
            quaternion_multiply(world[p], turn[j], world[j]);
        } else
            quaternion_multiply(back, world[j], turn[j]);
    }
    return true;
}

static double legs(const double at[][3]) {
    double sum = 0;
    for (int j = 4; j <= 8; j++) {
        if (j == 6) continue;
        double d[3];
        for (int k = 0; k < 3; k++) d[k] = at[j][k] - at[skeleton_parent[j]][k];
        sum += sqrt(dot3(d, d));
    }
    return sum;
}

/* at: frames x JOINTS x 3. Refuses legs that change their length. */
static sherf_status joints_to_clip(context *c, const double (*at)[JOINTS][3], const sherf_motion_options *o,
                                   source *s) {
    double min = INFINITY, max = 0;
    s->is_pelvis = true;
    for (int i = 0; i < s->clip.frames; i++) {
        const double now = legs(at[i]);
        min = fmin(min, now), max = fmax(max, now);
        if (!turns_from_joints(&s->skeleton, at[i], s->clip.turn[i]))
            return failure(c, SHERF_BAD_FILE, "frame %d: joints of a body do not lie in one place", i);
        for (int k = 0; k < 3; k++) s->clip.pelvis_m[i][k] = (float)at[i][0][k];
    }
    if (!(min > 1e-9 && max < 1.5 * min))
        return failure(c, SHERF_BAD_FILE, "legs of %.3g to %.3g units: these are no joints of SMPL", min,
                       max);
    s->unit_m = o->scale > 0 ? o->scale : 2 * legs(s->skeleton.rest_m) / (min + max);
    snprintf(s->detail + strlen(s->detail), sizeof s->detail - strlen(s->detail),
             "%sfrom joints, a unit is %.3g m by the legs", *s->detail ? ", " : "", s->unit_m);
    return SHERF_OK;
}

/* ---- HumanML3D ---- */

/* A frame's features: the root's rotation about y (half the angle for each frame), its steps in its own axes,
 * its height, the other joints in its axes, and derived values. */
static void features_frame(const double row[FEATURES], double half_turn, const double root[2],
                           double at[JOINTS][3]) {
    const double c = cos(2 * half_turn), sn = sin(2 * half_turn);
    at[0][0] = root[0], at[0][1] = row[3], at[0][2] = root[1];
    for (int j = 1; j < JOINTS; j++) {
        const double *p = row + 4 + 3 * (j - 1);
        at[j][0] = c * p[0] - sn * p[2] + root[0];
        at[j][1] = p[1];
        at[j][2] = sn * p[0] + c * p[2] + root[1];
    }
}

static sherf_status features_joints(context *c, const value *rows, int frames, double (*at)[JOINTS][3]) {
    double half_turn = 0, root[2] = {0}, row[FEATURES];
    for (int i = 0; i < frames; i++) {
        sherf_status status = parse_row(c, rows, (size_t)i, "features", FEATURES, row);
        if (status) return status;
        features_frame(row, half_turn, root, at[i]);
        half_turn += row[0]; /* of the next frame, in whose axes the step is given */
        const double co = cos(2 * half_turn), sn = sin(2 * half_turn);
        root[0] += co * row[1] - sn * row[2];
        root[1] += sn * row[1] + co * row[2];
    }
    return SHERF_OK;
}

/* The first joints of each row, which may also have hands, fingers and a face. */
static sherf_status joints_rows(context *c, const value *rows, int frames, double *at) {
    double row[JOINTS_MAX * 3];
    sherf_status status = SHERF_OK;
    for (int i = 0; i < frames && !status; i++) {
        status = parse_row(c, rows, (size_t)i, "joints", (size_t)rows->array.dim[1] * 3, row);
        if (!status) memcpy(at + (size_t)i * JOINTS * 3, row, JOINTS * 3 * sizeof *at);
    }
    return status;
}

/* (JOINTS, 3, T): frames last. */
static sherf_status joints_columns(context *c, const value *v, int all, int frames, double *at) {
    for (int i = 0; i < frames; i++)
        for (int j = 0; j < JOINTS * 3; j++) {
            double *to = at + (size_t)i * JOINTS * 3 + j;
            *to = value_array_number(v, (int64_t)j * all + i);
            if (!isfinite(*to)) return failure(c, SHERF_BAD_FILE, "joints hold a number that is not finite");
        }
    return SHERF_OK;
}

typedef enum { BY_FEATURES, BY_ROWS, BY_COLUMNS } joints_form;

/* all: frames in the array; only the first ones count. */
static sherf_status joints_read(context *c, const value *v, joints_form form, int64_t all, int64_t frames,
                                const sherf_motion_options *o, source *s) {
    sherf_status status = source_frames(c, s, o, frames, humanml_fps);
    if (status) return status;
    double(*at)[JOINTS][3] = mem_alloc(c, (size_t)frames, sizeof *at);
    if (!at) return SHERF_NO_MEMORY;
    status = form == BY_FEATURES ? features_joints(c, v, (int)frames, at)
             : form == BY_ROWS   ? joints_rows(c, v, (int)frames, (double *)at)
                                 : joints_columns(c, v, (int)all, (int)frames, (double *)at);
    if (!status) status = joints_to_clip(c, (const double(*)[JOINTS][3])at, o, s);
    mem_free(at);
    return status;
}

/* ---- Motion-X: a row of root, body, hands, jaw, face, translation and shape ---- */

static sherf_status motion_x_read(context *c, const value *v, const sherf_motion_options *o, source *s) {
    enum { TRANS = 309, BETAS = 312 };
    const int64_t frames = v->array.dim[0];
    double row[MOTION_X];
    s->format = "Motion-X";
    s->smplx = true;
    s->up = SHERF_UP_Y;
    s->unit_m = 1;
    sherf_status status = parse_row(c, v, 0, "row", MOTION_X, row);
    for (int i = 0; i < BODY_SHAPES && !status; i++) s->shapes[i] = (float)row[BETAS + i];
    s->has_shapes = true;
    if (!status) status = source_frames(c, s, o, frames, motion_x_fps);
    for (int i = 0; i < s->clip.frames && !status; i++) {
        status = parse_row(c, v, (size_t)i, "row", MOTION_X, row);
        value part = {.kind = VALUE_ARRAY, .array = {.type = T_F64, .rank = 1, .dim = {66}, .data = row}};
        if (!status)
            status = rotation_frame(c, "row", &part, SHERF_ROTATIONS_AXIS_ANGLE, whole_joints, 0, 22,
                                    s->clip.turn[i]);
        for (int k = 0; k < 3 && !status; k++) s->clip.pelvis_m[i][k] = (float)row[TRANS + k];
    }
    return status;
}

/* ---- MDM ---- */

/* The first two rows of a matrix. */
static sherf_status six_to_turn(context *c, const char *what, const double six[SIX], float q[4]) {
    static const six_form rows = {SIX_ROWS, false};
    double R[9];
    sherf_status status = six_matrix(c, what, &rows, six, R);
    if (!status) quaternion_from_matrix(R, q);
    return status;
}

/* Frames last: thetas BODY_JOINTS x SIX x all, and three rows of places from row `place` on, where the pelvis
 * is. */
typedef struct {
    const value *thetas, *places;
    int64_t place, all, frames; /* only the first frames count */
} columns;

static sherf_status columns_read(context *c, const columns *k, const sherf_motion_options *o, source *s) {
    s->unit_m = 1;
    s->is_pelvis = true;
    snprintf(s->detail + strlen(s->detail), sizeof s->detail - strlen(s->detail), "%smetres",
             *s->detail ? ", " : "");
    sherf_status status = source_frames(c, s, o, k->frames, humanml_fps);
    for (int i = 0; i < s->clip.frames && !status; i++) {
        double six[SIX];
        for (int j = 0; j < BODY_JOINTS; j++) {
            for (int n = 0; n < SIX; n++)
                six[n] = value_array_number(k->thetas, ((int64_t)j * SIX + n) * k->all + i);
            status = six_to_turn(c, "thetas", six, s->clip.turn[i][j]);
            if (status) return failure_prefix(c, status, "frame %d, joint %d", i, j);
        }
        for (int n = 0; n < 3; n++)
            s->clip.pelvis_m[i][n] = (float)value_array_number(k->places, (k->place + n) * k->all + i);
    }
    return status;
}

static bool shape_is(const value *v, int rank, int64_t first, int64_t second) {
    return v && v->kind == VALUE_ARRAY && v->array.rank == rank && (!first || v->array.dim[0] == first) &&
           (!second || v->array.dim[1] == second);
}

static bool thetas_are(const value *root) {
    const value *thetas = value_get(root, "thetas"), *places = value_get(root, "root_translation");
    return shape_is(thetas, 3, BODY_JOINTS, SIX) && shape_is(places, 2, 3, thetas->array.dim[2]);
}

static sherf_status thetas_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    const value *thetas = value_get(root, "thetas");
    const int64_t frames = thetas->array.dim[2];
    s->format = "MDM";
    s->up = SHERF_UP_Y;
    return columns_read(c, &(columns){thetas, value_get(root, "root_translation"), 0, frames, frames}, o, s);
}

/* results.npy: samples x joints x numbers x T, and how many frames of each count. */
static bool samples_are(const value *root) {
    return shape_is(value_get(root, "motion"), 4, 0, 0) && value_get(root, "lengths");
}

/* Text models write HumanML3D's 22 joints, y up; those of actions SMPL's 24 in a camera's view, or, as the
 * network gives them, six numbers for each and the place as one joint more. */
static bool samples_fit(const value *motion, bool *six) {
    const int64_t joints = motion->array.dim[1], per = motion->array.dim[2];
    *six = joints == BODY_JOINTS + 1 && per == SIX;
    return *six || (per == 3 && (joints == JOINTS || joints == BODY_JOINTS));
}

static sherf_status samples_refused(context *c, const value *motion) {
    const int64_t *dim = motion->array.dim;
    const char *why = "";
    if (dim[1] == 21 && dim[2] == 3) why = ": KIT-ML's skeleton, not SMPL's; take a model of HumanML3D";
    if (dim[1] == FEATURES && dim[2] == 1)
        why = ": features as the network gives them; MDM's sample.generate makes joints of them";
    return failure(c, SHERF_BAD_FILE,
                   "MDM: a motion of %lld x %lld x %lld x %lld, not samples x 22 (or 24) joints x 3 x frames "
                   "or x 25 x 6 x frames%s",
                   (long long)dim[0], (long long)dim[1], (long long)dim[2], (long long)dim[3], why);
}

static sherf_status samples_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    const value *motion = value_get(root, "motion");
    const int64_t samples = motion->array.dim[0], joints = motion->array.dim[1], all = motion->array.dim[3];
    char *end = NULL;
    const int64_t wanted = o->track ? strtoll(o->track, &end, 10) : 0;
    double length;
    bool six;
    s->format = "MDM";
    if (!samples_fit(motion, &six)) return samples_refused(c, motion);
    if (wanted < 0 || wanted >= samples || (end && (end == o->track || *end)))
        return failure(c, SHERF_BAD_ARGUMENT, "no track '%.60s' among the %lld of the file",
                       o->track ? o->track : "0", (long long)samples);
    snprintf(s->detail, sizeof s->detail, "track %lld of %lld", (long long)wanted, (long long)samples);
    sherf_status status = parse_row(c, value_get(root, "lengths"), (size_t)wanted, "lengths", 1, &length);
    if (status) return status;
    const value own = parse_row_of(motion, (size_t)wanted);
    const int64_t frames = length >= 1 && length < (double)all ? (int64_t)length : all;
    s->up = joints == JOINTS ? SHERF_UP_Y : SHERF_UP_MINUS_Y;
    return six ? columns_read(c, &(columns){&own, &own, BODY_JOINTS * SIX, all, frames}, o, s)
               : joints_read(c, &own, BY_COLUMNS, all, frames, o, s);
}

/* ---- which ---- */

static sherf_status poses_rows(context *c, const value *v, const sherf_motion_options *o, source *s) {
    s->format = "SMPL poses";
    s->up = SHERF_UP_Y;
    s->unplaced = true;
    const int64_t frames = v->array.dim[0];
    sherf_status status = source_frames(c, s, o, frames, 30);
    return status ? status
                  : rotation_rows(c, "poses", v, o->rotations, whole_joints, 0,
                                  source_body_joints(value_numbers(v) / frames), &s->clip);
}

/* Left and right legs of equal length, shins about as long as thighs, a head that is not among the hips:
 * joint positions satisfy this, rotations do not. */
static bool is_skeleton(const value *row) {
    double at[JOINTS_MAX * 3], bone[4] = {0}, up = 0;
    static const int8_t from[4] = {1, 2, 4, 5}, to[4] = {4, 5, 7, 8};
    for (int i = 0; i < 16 * 3; i++) at[i] = value_array_number(row, i);
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 4; i++) {
            const double d = at[3 * to[i] + k] - at[3 * from[i] + k];
            bone[i] += d * d;
        }
        up += (at[3 * 15 + k] - at[k]) * (at[3 * 15 + k] - at[k]);
    }
    const double thigh = sqrt(bone[0]), shin = sqrt(bone[2]);
    return fabs(thigh - sqrt(bone[1])) < 0.1 * thigh && fabs(shin - sqrt(bone[3])) < 0.1 * shin &&
           fabs(thigh - shin) < 0.3 * thigh && sqrt(up) > 0.8 * thigh && sqrt(up) < 2.5 * thigh;
}

static bool is_triples(const value *v, int64_t joints) {
    return shape_is(v, 3, 0, joints) && v->array.dim[2] == 3 && v->array.dim[0] > 0;
}

/* (F, joints, 3): positions if the first frame and the middle one look like a person. With 22 joints, which
 * are usually positions, reading reports the error. */
static bool joints_are(const value *v) {
    static const int8_t more[] = {24, 52, 55};
    if (is_triples(v, JOINTS)) return true;
    for (size_t i = 0; i < COUNT_OF(more); i++)
        if (is_triples(v, more[i])) {
            const value first = parse_row_of(v, 0), middle = parse_row_of(v, (size_t)v->array.dim[0] / 2);
            return is_skeleton(&first) && is_skeleton(&middle);
        }
    return false;
}

/* A row of six numbers a joint for each frame. */
static bool sixes_are(const value *v) {
    if (v->array.rank < 2 || v->array.rank > 4 || v->array.dim[0] < 1) return false;
    const value row = parse_row_of(v, 0);
    return six_joints(&row, whole_joints) > 0;
}

static bool poses_are(const value *v) {
    return shape_is(v, 2, 0, 72) || shape_is(v, 2, 0, 156) || shape_is(v, 2, 0, 165) ||
           ((is_triples(v, 24) || is_triples(v, 52) || is_triples(v, 55)) && !joints_are(v)) ||
           (shape_is(v, 4, 0, BODY_JOINTS) && v->array.dim[2] == 3 && v->array.dim[3] == 3) || sixes_are(v);
}

static bool array_is(const value *v) {
    return shape_is(v, 2, 0, FEATURES) || shape_is(v, 2, 0, MOTION_X) || joints_are(v) || poses_are(v);
}

/* Without a leading axis of 1 (a batch of one), if the rest is a known layout. */
static value squeezed(const value *root) {
    value own = *root;
    while (own.kind == VALUE_ARRAY && own.array.rank > 2 && own.array.dim[0] == 1 && !array_is(&own))
        own = parse_row_of(&own, 0);
    return own;
}

bool joints_file_is(const value *root) {
    if (!root || root->kind != VALUE_ARRAY) return thetas_are(root) || samples_are(root);
    const value own = squeezed(root);
    return array_is(&own);
}

sherf_status joints_file_read(context *c, const value *root, const sherf_motion_options *o, source *s) {
    if (thetas_are(root)) return thetas_read(c, root, o, s);
    if (samples_are(root)) return samples_read(c, root, o, s);
    const value own = squeezed(root);
    root = &own;
    if (shape_is(root, 2, 0, MOTION_X)) return motion_x_read(c, root, o, s);
    if (poses_are(root)) return poses_rows(c, root, o, s);
    s->format = "HumanML3D";
    s->up = SHERF_UP_Y;
    const int64_t frames = root->array.dim[0];
    return joints_read(c, root, joints_are(root) ? BY_ROWS : BY_FEATURES, frames, frames, o, s);
}
