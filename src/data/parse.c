/* Reads poses and rows of numbers from values. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "data/parse.h"

enum { JOINTS_MAX = 55 }; /* SMPL-X's */

int64_t parse_rows(const value *v) {
    if (!v) return -1;
    if (v->kind == VALUE_LIST) return (int64_t)v->list.count;
    if (v->kind == VALUE_ARRAY && v->array.rank >= 1) return v->array.dim[0];
    return -1;
}

value parse_row_of(const value *v, size_t i) {
    if (v->kind == VALUE_LIST) return *v->list.item[i];
    value row = *v;
    size_t bytes = dtype_size(v->array.type);
    row.array.rank--;
    for (int k = 0; k < row.array.rank; k++) {
        row.array.dim[k] = v->array.dim[k + 1];
        bytes *= (size_t)row.array.dim[k];
    }
    row.array.data = (char *)v->array.data + i * bytes;
    return row;
}

sherf_status parse_row(context *c, const value *v, size_t i, const char *what, size_t count, double *out) {
    int64_t rows = parse_rows(v);
    if (rows < 0 || i >= (uint64_t)rows)
        return failure(c, SHERF_BAD_FILE, "%s: no entry %zu (there are %lld)", what, i,
                       (long long)(rows < 0 ? 0 : rows));
    const value row = parse_row_of(v, i);
    return value_doubles(c, &row, what, count, out);
}

sherf_status parse_prefix(context *c, const value *v, const char *what, int max, float *out) {
    enum { LONGEST = 4096 };
    int64_t n = value_numbers(v);
    if (n < 0 && v && (v->kind == VALUE_REAL || v->kind == VALUE_INTEGER)) n = 1;
    if (n < 1 || n > LONGEST)
        return failure(c, SHERF_BAD_FILE, "%s: %s", what,
                       n < 1 ? "numbers are missing" : "far too many numbers");
    float all[LONGEST];
    sherf_status status = value_floats(c, v, what, (size_t)n, all);
    if (status) return status;
    for (int i = 0; i < max; i++) out[i] = i < n ? all[i] : 0;
    return SHERF_OK;
}

sherf_status rotation_check(context *c, const float R[9], const char *what) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double dot = 0;
            for (int k = 0; k < 3; k++) dot += (double)R[i * 3 + k] * R[j * 3 + k];
            if (!(fabs(dot - (i == j)) < 2e-3))
                return failure(c, SHERF_BAD_FILE, "%s: not a rotation matrix", what);
        }
    double determinant = (double)R[0] * (R[4] * R[8] - R[5] * R[7]) -
                         (double)R[1] * (R[3] * R[8] - R[5] * R[6]) +
                         (double)R[2] * (R[3] * R[7] - R[4] * R[6]);
    if (determinant < 0)
        return failure(c, SHERF_BAD_FILE, "%s: a mirroring, not a rotation (determinant -1)", what);
    return SHERF_OK;
}

sherf_status parse_rotation(context *c, const value *v, const char *what, float R[9]) {
    int64_t n = value_numbers(v);
    sherf_status status;
    if (n == 3) {
        float axis_angle[3];
        status = value_floats(c, v, what, 3, axis_angle);
        double square = 0;
        for (int k = 0; k < 3 && !status; k++) square += (double)axis_angle[k] * axis_angle[k];
        if (!status) status = radians_check(c, what, true, square, 1);
        if (!status) rodrigues(axis_angle, R);
        return status;
    }
    if (n != 9)
        return failure(c, SHERF_BAD_FILE, "%s: neither 3 numbers (axis-angle) nor 9 (a matrix)", what);
    status = value_floats(c, v, what, 9, R);
    return status ? status : rotation_check(c, R, what);
}

sherf_status radians_check(context *c, const char *what, bool root, double squares, int64_t count) {
    const double largest = root ? 12.6 : 4; /* an axis-angle is at most pi long, unless it was unwrapped */
    if (count < 1 || !(sqrt(squares / (double)count) > largest)) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "%s: %.3g radians a joint on average: these are degrees", what,
                   sqrt(squares / (double)count));
}

sherf_status joints_last_check(context *c, const char *what, const value *v, int joints) {
    enum { NUMBERS_MAX = 9 };
    if (v->kind != VALUE_ARRAY || v->array.rank < 2 || joints <= NUMBERS_MAX) return SHERF_OK;
    if (v->array.dim[v->array.rank - 1] != joints) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE,
                   "%s: its last axis is that of the %d joints: the numbers of a joint must be last (%d x 3)",
                   what, joints, joints);
}

/* The position of the quaternions' real part: most joints turn by less than a right angle. */
static bool real_is_last(const float *q, int joints) {
    double first = 0, last = 0;
    for (int j = 0; j < joints; j++) first += fabs(q[4 * j]), last += fabs(q[4 * j + 3]);
    return last > first;
}

static sherf_status quaternion_turn(context *c, const char *what, const float *q, bool last, float turn[3]) {
    const double w = q[last ? 3 : 0];
    const float *v = q + !last;
    const double sine = sqrt((double)v[0] * v[0] + (double)v[1] * v[1] + (double)v[2] * v[2]);
    if (!(fabs(w * w + sine * sine - 1) < 0.05))
        return failure(c, SHERF_BAD_FILE, "%s: a quaternion of length %g", what, sqrt(w * w + sine * sine));
    const double angle = 2 * atan2(sine, fabs(w)) * (w < 0 ? -1 : 1);
    for (int k = 0; k < 3; k++) turn[k] = sine > 1e-9 ? (float)(v[k] / sine * angle) : 0;
    return SHERF_OK;
}

/* How a body's rotations are stored, found for its joints and used for its root. */
typedef struct {
    bool last; /* the quaternions' real part is */
    six_kind said;
    six_form six; /* kind unknown: not six numbers */
} stored_form;

/* Six numbers each, of the joints from `first` on, the first `joints` of `given`. */
static sherf_status parse_six(context *c, const value *v, const char *what, int first, int given, int joints,
                              stored_form *form, float *poses) {
    double all[JOINTS_MAX * SIX];
    six_evidence shown = {0};
    sherf_status status = value_doubles(c, v, what, (size_t)given * SIX, all);
    if (!status && !form->six.kind) {
        six_add(&shown, all, given, first);
        status = six_decide(c, what, &shown, form->said, &form->six);
        if (!status && !form->said) six_log(c, what, &form->six);
    }
    for (int j = 0; j < joints && !status; j++) {
        double R[9];
        float single[9];
        status = six_matrix(c, what, &form->six, all + SIX * j, R);
        for (int i = 0; i < 9 && !status; i++) single[i] = (float)R[i];
        if (!status) rotation_to_axis_angle(single, poses + (first + j) * 3);
    }
    return status;
}

/* Joint rotations from `first` on: axis-angle, quaternions, 3 x 3 matrices, or six numbers, of `given`
 * joints; those beyond `joints` (fingers, a face) are ignored. Missing joints stay 0. */
static sherf_status parse_joints(context *c, const value *v, const char *what, int first, int given,
                                 int joints, stored_form *form, float *poses) {
    float all[JOINTS_MAX * 9];
    const bool matrices = value_numbers(v) == given * 9, quaternions = value_numbers(v) == given * 4;
    if (six_joints(v, (const int[]){given, 0}) && (given > 1 || form->six.kind))
        return parse_six(c, v, what, first, given, joints, form, poses);
    sherf_status status = value_floats(c, v, what, (size_t)given * (matrices ? 9 : quaternions ? 4 : 3), all);
    if (quaternions && given > 1 && !status) form->last = real_is_last(all, given);
    if (!status) status = joints_last_check(c, what, v, given);
    double squares = 0;
    for (int j = 0; j < joints && !status; j++) {
        float *pose = poses + (first + j) * 3;
        if (matrices) status = rotation_check(c, all + j * 9, what);
        if (!status && matrices) rotation_to_axis_angle(all + j * 9, pose);
        if (!status && quaternions) status = quaternion_turn(c, what, all + 4 * j, form->last, pose);
        if (!matrices && !quaternions) memcpy(pose, all + 3 * j, 3 * sizeof *pose);
        for (int k = 0; k < 3; k++) squares += (double)pose[k] * pose[k];
    }
    return status ? status : radians_check(c, what, joints < 2, squares, joints);
}

/* How many joints the numbers of a whole body are; those of SMPL where nothing fits. */
static int joints_given(const value *poses) {
    static const int whole[] = {22, 52, 55,
                                53, 26, 29}; /* the last two: EasyMocap's hands in 12 numbers, a face in 9 */
    static const int of_six[] = {24, 22, 52, 55, 53, 0};
    const int64_t numbers = value_numbers(poses);
    int given = six_joints(poses, of_six);
    for (size_t i = 0; i < COUNT_OF(whole) && !given; i++)
        if (numbers == whole[i] * 3 || (i < 4 && (numbers == whole[i] * 9 || numbers == whole[i] * 4)))
            given = whole[i];
    return given ? given : BODY_JOINTS;
}

/* SMPL+H and SMPL-X files list 21 body joints: the two hands of SMPL then stay at rest. */
static sherf_status parse_turns(context *c, const body_parts *parts, sherf_pose *out, bool *smplx) {
    static const int of_six[] = {23, 21, 0};
    stored_form form = {.said = parts->six};
    const named_value *poses = &parts->part[PART_POSES], *body = &parts->part[PART_BODY],
                      *root = &parts->part[PART_ROOT];
    if (poses->item && !(body->item && root->item)) {
        const int given = joints_given(poses->item);
        *smplx |= given == JOINTS_MAX || given == 53 || given == 29;
        return parse_joints(c, poses->item, poses->name, 0, given, given == BODY_JOINTS ? given : 22, &form,
                            out->poses_rad);
    }
    const int64_t n = value_numbers(body->item);
    int joints = six_joints(body->item, of_six);
    if (!joints) joints = n == 63 || n == 21 * 9 || n == 21 * 4 ? 21 : 23;
    sherf_status status = parse_joints(c, body->item, body->name, 1, joints, joints, &form, out->poses_rad);
    if (!status && root->item)
        status = parse_joints(c, root->item, root->name, 0, 1, 1, &form, out->poses_rad);
    return status;
}

/* SMPL-X's own space is SMPL's, shifted: R (x + d) + Th. */
static void place_smplx(sherf_pose *pose) {
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) pose->Th_m[i] += pose->R[3 * i + k] * (float)smplx_pelvis_m[k];
}

/* The template's pelvis to this place; joint 0 turns the body about it. */
static sherf_status place_pelvis(context *c, const named_value *at, sherf_pose *pose) {
    float pelvis[3];
    sherf_status status = value_floats(c, at->item, at->name, 3, pelvis);
    for (int i = 0; i < 3 && !status; i++) {
        pose->Th_m[i] = pelvis[i];
        for (int k = 0; k < 3; k++) pose->Th_m[i] -= pose->R[3 * i + k] * (float)smpl_pelvis_m[k];
    }
    return status;
}

/* x_camera = R_c (R x_smpl + Th) + T_c: into R and Th. */
static void put_before_camera(const float Rc[9], const float Tc[3], sherf_pose *pose) {
    float R[9], Th[3];
    for (int i = 0; i < 9; i++) {
        R[i] = 0;
        for (int k = 0; k < 3; k++) R[i] += Rc[i / 3 * 3 + k] * pose->R[3 * k + i % 3];
    }
    for (int i = 0; i < 3; i++) {
        Th[i] = Tc[i];
        for (int k = 0; k < 3; k++) Th[i] += Rc[3 * i + k] * pose->Th_m[k];
    }
    memcpy(pose->R, R, sizeof R);
    memcpy(pose->Th_m, Th, sizeof Th);
}

/* The world in the body's unit. */
static sherf_status unscaled(context *c, const named_value *scaling, sherf_pose *pose) {
    double s;
    sherf_status status = value_doubles(c, scaling->item, scaling->name, 1, &s);
    if (!status && !(s > 1e-6 && s < 1e6)) status = failure(c, SHERF_BAD_FILE, "%s is %g", scaling->name, s);
    for (int k = 0; k < 3 && !status; k++) pose->Th_m[k] = (float)(pose->Th_m[k] / s);
    return status;
}

sherf_status parse_parts(context *c, const body_parts *parts, sherf_pose *out) {
    const named_value *part = parts->part, *R = &part[PART_TURN], *Th = &part[PART_PLACE],
                      *shapes = &part[PART_SHAPES], *Rc = &part[PART_CAMERA_TURN],
                      *Tc = &part[PART_CAMERA_PLACE];
    float turn[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, place[3] = {0};
    sherf_pose_identity(out);
    bool smplx = parts->smplx;
    sherf_status status = parse_turns(c, parts, out, &smplx);
    if (!status && shapes->item)
        status = parse_prefix(c, shapes->item, shapes->name, BODY_SHAPES, out->shapes);
    if (!status && R->item) status = parse_rotation(c, R->item, R->name, out->R);
    if (!status && Th->item) status = value_floats(c, Th->item, Th->name, 3, out->Th_m);
    if (!status && parts->scaling.item) status = unscaled(c, &parts->scaling, out);
    if (!status && Rc->item) status = parse_rotation(c, Rc->item, Rc->name, turn);
    if (!status && Tc->item) status = value_floats(c, Tc->item, Tc->name, 3, place);
    if (!status && smplx && (Th->item || (Tc->item && !part[PART_PELVIS].item))) place_smplx(out);
    if (!status && part[PART_PELVIS].item) status = place_pelvis(c, &part[PART_PELVIS], out);
    if (!status && (Rc->item || Tc->item)) put_before_camera(turn, place, out);
    return status;
}

sherf_status parse_pose(context *c, const value *v, sherf_pose *out) {
    body_parts parts;
    body_parts_find(v, &parts);
    if (!parts.part[PART_POSES].item && !parts.part[PART_BODY].item) return body_parts_missing(c, v);
    return parse_parts(c, &parts, out);
}

sherf_status parse_file(context *c, const char *path, document **out, const char **kind) {
    *out = NULL;
    if (path_is_folder(path)) return failure(c, SHERF_BAD_FILE, "%s: a folder, not a file", path);
    return document_read(c, path, out, kind);
}

sherf_status path_join(context *c, char *out, size_t size, const char *folder, const char *name) {
    int n = snprintf(out, size, "%s%s%s", folder, *folder ? "/" : "", name);
    if (n >= 0 && (size_t)n < size) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "%.200s/%.200s: path too long", folder, name);
}

sherf_status path_inside(context *c, const char *relative) {
    bool outside = relative[0] == '/' || !relative[0];
    for (const char *p = relative; *p; p++)
        if ((p == relative || p[-1] == '/') && p[0] == '.' && p[1] == '.' && (p[2] == '/' || !p[2]))
            outside = true;
    if (!outside) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "\"%.200s\": a path that leaves its folder", relative);
}
