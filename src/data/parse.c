/* Cameras, poses and rows of numbers out of values. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "data/parse.h"

int64_t parse_rows(const value *v) {
    if (!v) return -1;
    if (v->kind == VALUE_LIST) return (int64_t)v->list.count;
    if (v->kind == VALUE_ARRAY && v->array.rank >= 1) return v->array.dim[0];
    return -1;
}

const value *parse_unwrapped(const value *v) {
    while (v && v->kind == VALUE_LIST && v->list.count == 1) v = v->list.item[0];
    return v;
}

sherf_status parse_row(context *c, const value *v, size_t i, const char *what, size_t count, double *out) {
    int64_t rows = parse_rows(v);
    if (rows < 0 || i >= (uint64_t)rows)
        return failure(c, SHERF_BAD_FILE, "%s: no entry %zu (there are %lld)", what, i,
                       (long long)(rows < 0 ? 0 : rows));
    if (v->kind == VALUE_LIST) return value_doubles(c, value_at(v, i), what, count, out);
    value row = *v;
    size_t row_values = 1;
    row.array.rank--;
    for (int k = 0; k < row.array.rank; k++) {
        row.array.dim[k] = v->array.dim[k + 1];
        row_values *= (size_t)row.array.dim[k];
    }
    row.array.data = (char *)v->array.data + i * row_values * dtype_size(v->array.type);
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
        if (!status) rodrigues(axis_angle, R);
        return status;
    }
    if (n != 9)
        return failure(c, SHERF_BAD_FILE, "%s: neither 3 numbers (axis-angle) nor 9 (a matrix)", what);
    status = value_floats(c, v, what, 9, R);
    return status ? status : rotation_check(c, R, what);
}

/* Joint rotations from `first` on: axis-angle, or 3 x 3 matrices. Joints that are not given stay 0. */
static sherf_status parse_joints(context *c, const value *v, const char *what, int first, int joints,
                                 float *poses) {
    int64_t n = value_numbers(v);
    if (n == joints * 9) {
        float R[BODY_JOINTS * 9];
        sherf_status status = value_floats(c, v, what, (size_t)n, R);
        for (int j = 0; j < joints && !status; j++) {
            status = rotation_check(c, R + j * 9, what);
            if (!status) rotation_to_axis_angle(R + j * 9, poses + (first + j) * 3);
        }
        return status;
    }
    return value_floats(c, v, what, (size_t)joints * 3, poses + first * 3);
}

static const value *get_either(const value *v, const char *a, const char *b) {
    const value *found = value_get(v, a);
    return found ? found : value_get(v, b);
}

/* SMPL+H and SMPL-X files list 21 body joints: the two hands of SMPL then stay at rest. */
static sherf_status parse_smpl_names(context *c, const value *v, sherf_pose *out) {
    const value *body = value_get(v, "body_pose"), *root = value_get(v, "global_orient");
    int64_t n = value_numbers(body);
    int joints = n == 63 || n == 21 * 9 ? 21 : 23;
    sherf_status status = parse_joints(c, body, "body_pose", 1, joints, out->poses_rad);
    if (!status && root) status = parse_joints(c, root, "global_orient", 0, 1, out->poses_rad);
    return status;
}

sherf_status parse_pose(context *c, const value *v, sherf_pose *out) {
    sherf_pose_identity(out);
    sherf_status status = SHERF_OK;
    const value *poses = get_either(v, "poses", "pose");
    const value *shapes = get_either(v, "shapes", "betas");
    const char *Th_name = value_get(v, "Th") ? "Th" : value_get(v, "transl") ? "transl" : "trans";
    const value *Th = value_get(v, Th_name);
    const value *R = get_either(v, "R", "Rh");
    if (poses)
        status = parse_joints(c, poses, "poses", 0, BODY_JOINTS, out->poses_rad);
    else if (value_get(v, "body_pose"))
        status = parse_smpl_names(c, v, out);
    else
        status = failure(c, SHERF_BAD_FILE, "a body needs poses (72 numbers) or body_pose (69)");
    if (!status && shapes)
        status =
            parse_prefix(c, shapes, value_get(v, "shapes") ? "shapes" : "betas", BODY_SHAPES, out->shapes);
    if (!status && R) status = parse_rotation(c, R, value_get(v, "R") ? "R" : "Rh", out->R);
    if (!status && Th) status = value_floats(c, Th, Th_name, 3, out->Th_m);
    return status;
}

sherf_status parsed_camera_check(context *c, const parsed_camera *camera) {
    const double *K = camera->K;
    for (int i = 0; i < 9; i++)
        if (!isfinite((float)K[i]) || !isfinite((float)camera->R[i])) /* 1e39 is not one either */
            return failure(c, SHERF_BAD_FILE, "camera: %c has a value that is not finite",
                           isfinite((float)K[i]) ? 'R' : 'K');
    for (int i = 0; i < 3; i++)
        if (!isfinite((float)camera->T[i]))
            return failure(c, SHERF_BAD_FILE, "camera: T has a value that is not finite");
    for (int i = 0; i < 5; i++)
        if (!isfinite(camera->D[i]))
            return failure(c, SHERF_BAD_FILE, "camera: D has a value that is not finite");
    double determinant = K[0] * (K[4] * K[8] - K[5] * K[7]) - K[1] * (K[3] * K[8] - K[5] * K[6]) +
                         K[2] * (K[3] * K[7] - K[4] * K[6]);
    if (!(fabs(determinant) > 1e-12) || !(fabs(K[0]) > 1e-6) || !(fabs(K[4]) > 1e-6))
        return failure(c, SHERF_BAD_FILE, "camera: K is singular");
    if (fabs(K[6]) > 1e-9 || fabs(K[7]) > 1e-9 || fabs(K[8] - 1) > 1e-9)
        return failure(c, SHERF_BAD_FILE, "camera: K's last row is not 0 0 1");
    float R[9];
    for (int i = 0; i < 9; i++) R[i] = (float)camera->R[i];
    return rotation_check(c, R, "camera: R");
}

sherf_status parse_camera(context *c, const value *v, parsed_camera *out) {
    *out = (parsed_camera){.R = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    const value *D = get_either(v, "D", "distortion");
    sherf_status status = value_doubles(c, value_get(v, "K"), "camera: K", 9, out->K);
    if (!status) status = value_doubles(c, value_get(v, "R"), "camera: R", 9, out->R);
    if (!status) status = value_doubles(c, value_get(v, "T"), "camera: T", 3, out->T);
    if (!status && D) {
        float five[5];
        status = parse_prefix(c, D, "camera: D", 5, five);
        if (!status && value_numbers(D) == 5) status = value_doubles(c, D, "camera: D", 5, out->D);
        if (!status && value_numbers(D) != 5)
            for (int i = 0; i < 5; i++) out->D[i] = five[i];
    }
    return status ? status : parsed_camera_check(c, out);
}

void parsed_camera_to(const parsed_camera *in, int file_width, int file_height, int width, int height,
                      sherf_camera *out) {
    *out = (sherf_camera){.width_px = width, .height_px = height};
    double scale[3] = {(double)width / file_width, (double)height / file_height, 1};
    for (int i = 0; i < 9; i++) {
        out->K[i] = (float)(in->K[i] * scale[i / 3]);
        out->R[i] = (float)in->R[i];
    }
    for (int i = 0; i < 3; i++) out->T_m[i] = (float)in->T[i];
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
