/* Cameras out of values: K, R, T and D by the names and in the forms that tools write them. */
#include <math.h>
#include <string.h>

#include "data/parse.h"

static const char *const K_names[] = {
    "K", "intrinsic", "intrinsics", "cam_intrinsics", "intrinsic_matrix", "camera_matrix", "intrins", NULL};
static const char *const focal_names[] = {"focal_px", "focal",     "focal_length", "focal_l",
                                          "f",        "img_focal", "focals",       NULL};
static const char *const focal_x_names[] = {"fx", "fl_x", NULL}, *const focal_y_names[] = {"fy", "fl_y",
                                                                                           NULL};
static const char *const centre_names[] = {
    "princpt", "principal_point", "camera_center", "center", "c", "img_center", NULL};
static const char *const centre_x_names[] = {"cx", NULL}, *const centre_y_names[] = {"cy", NULL};
static const char *const field_names[] = {"fov_deg", NULL};
static const char *const R_names[] = {"R",   "Rvec", "rvec", "rotation", "cam_R", "camera_rotation",
                                      "Rot", NULL};
static const char *const T_names[] = {
    "T", "t", "Tvec", "tvec", "trans", "cam_t", "translation", "camera_translation", NULL};
static const char *const to_camera_names[] = {
    "RT",  "Rt",        "extrinsic",       "extrinsics",     "extri",
    "w2c", "world2cam", "world_to_camera", "cam_extrinsics", "extrinsic_matrix",
    NULL};
static const char *const to_world_names[] = {"c2w", "cam2world", "camera_to_world", "cam_to_world", NULL};
static const char *const D_names[] = {
    "D", "distortion", "dist", "dist_coeffs", "distCoeffs", "distortion_coefficients", "dist_coeff", NULL};
static const char *const width_names[] = {"width", "w", "W", "image_width", NULL}, *const height_names[] = {
                                                                                       "height", "h", "H",
                                                                                       "image_height", NULL};
static const char *const idle_names[] = {"name", "id", "comment", NULL};

static const char *const *const all_names[] = {K_names,      focal_names,    focal_x_names,   focal_y_names,
                                               centre_names, centre_x_names, centre_y_names,  field_names,
                                               R_names,      T_names,        to_camera_names, to_world_names,
                                               D_names,      width_names,    height_names,    idle_names};

static sherf_status number_of(context *c, named_value n, double *out) {
    return value_doubles(c, n.item, n.name, 1, out);
}

/* One number for both axes, or one each. */
static sherf_status pair_of(context *c, named_value n, double out[2]) {
    if (value_numbers(n.item) == 2) return value_doubles(c, n.item, n.name, 2, out);
    sherf_status status = number_of(c, n, out);
    out[1] = out[0];
    return status;
}

/* 3 x 3, or fx fy cx cy. */
static sherf_status K_whole(context *c, named_value n, double K[9]) {
    double four[4];
    if (value_numbers(n.item) != 4) return value_doubles(c, n.item, n.name, 9, K);
    sherf_status status = value_doubles(c, n.item, n.name, 4, four);
    K[0] = four[0], K[4] = four[1], K[2] = four[2], K[5] = four[3];
    return status;
}

static sherf_status K_field(context *c, named_value n, const int size[2], double K[9]) {
    double degrees;
    sherf_status status = number_of(c, n, &degrees);
    if (!status && !(degrees > 0.1 && degrees < 179))
        status = failure(c, SHERF_BAD_FILE, "fov_deg should lie between 0.1 and 179");
    if (!status) K[0] = K[4] = size[1] / 2. / tan(degrees * 3.14159265358979323846 / 360);
    return status;
}

static sherf_status centre_of(context *c, const value *v, double K[9]) {
    const named_value both = value_first(v, centre_names), x = value_first(v, centre_x_names),
                      y = value_first(v, centre_y_names);
    double centre[2] = {K[2], K[5]};
    sherf_status status = both.item ? value_doubles(c, both.item, both.name, 2, centre) : SHERF_OK;
    if (!status && x.item) status = number_of(c, x, &centre[0]);
    if (!status && y.item) status = number_of(c, y, &centre[1]);
    K[2] = centre[0], K[5] = centre[1];
    return status;
}

/* K, or focal lengths, or a vertical field of view; the centre is the picture's middle unless it is said. */
static sherf_status K_of(context *c, const value *v, const int size[2], double K[9]) {
    const named_value whole = value_first(v, K_names), focal = value_first(v, focal_names),
                      x = value_first(v, focal_x_names), y = value_first(v, focal_y_names),
                      field = value_first(v, field_names);
    double two[2];
    if (whole.item) return K_whole(c, whole, K);
    if (!size) return keys_missing(c, v, "K is missing");
    if (field.item) return K_field(c, field, size, K);
    if (!focal.item && !x.item) return keys_missing(c, v, "needs K, fov_deg or focal_px");
    sherf_status status = focal.item ? pair_of(c, focal, two) : pair_of(c, x, two);
    if (!status && !focal.item && y.item) status = number_of(c, y, &two[1]);
    if (!status) K[0] = two[0], K[4] = two[1];
    return status ? status : centre_of(c, v, K);
}

/* x = R x' + T the other way round: R^T, -R^T T. */
static void inverted(double R[9], double T[3]) {
    double turned[9], moved[3];
    for (int i = 0; i < 9; i++) turned[i] = R[i % 3 * 3 + i / 3];
    for (int i = 0; i < 3; i++)
        moved[i] = -(turned[3 * i] * T[0] + turned[3 * i + 1] * T[1] + turned[3 * i + 2] * T[2]);
    memcpy(R, turned, sizeof turned);
    memcpy(T, moved, sizeof moved);
}

/* 3 x 4 or 4 x 4, row by row. */
static sherf_status matrix_of(context *c, named_value n, parsed_camera *out) {
    double m[16] = {0};
    const int64_t numbers = value_numbers(n.item);
    sherf_status status = value_doubles(c, n.item, n.name, numbers == 12 ? 12 : 16, m);
    if (status) return status;
    if (numbers == 16 && (m[12] != 0 || m[13] != 0 || m[14] != 0 || fabs(m[15] - 1) > 1e-6)) {
        const bool column = m[3] == 0 && m[7] == 0 && m[11] == 0;
        return failure(c, SHERF_BAD_FILE, "%s: the last row is not 0 0 0 1%s", n.name,
                       column ? ", the last column is: this is the transposed matrix" : "");
    }
    for (int i = 0; i < 12; i++)
        if (i % 4 < 3)
            out->R[i / 4 * 3 + i % 4] = m[i];
        else
            out->T[i / 4] = m[i];
    return SHERF_OK;
}

static sherf_status R_of(context *c, named_value n, double R[9]) {
    float turn[9];
    if (value_numbers(n.item) == 9) return value_doubles(c, n.item, n.name, 9, R);
    sherf_status status = parse_rotation(c, n.item, n.name, turn);
    for (int i = 0; i < 9 && !status; i++) R[i] = turn[i];
    return status;
}

static sherf_status place_of(context *c, const value *v, parsed_camera *out) {
    const named_value R = value_first(v, R_names), T = value_first(v, T_names),
                      to_camera = value_first(v, to_camera_names), to_world = value_first(v, to_world_names);
    const named_value matrix = to_camera.item ? to_camera : to_world;
    sherf_status status = SHERF_OK;
    out->turned = R.item || matrix.item;
    out->moved = T.item || matrix.item;
    if (matrix.item && (R.item || T.item || (to_camera.item && to_world.item)))
        return failure(c, SHERF_BAD_FILE, "its place is told twice, by %s and by %s", matrix.name,
                       R.item   ? R.name
                       : T.item ? T.name
                                : to_world.name);
    if (matrix.item) status = matrix_of(c, matrix, out);
    if (!status && R.item) status = R_of(c, R, out->R);
    if (!status && T.item) status = value_doubles(c, T.item, T.name, 3, out->T);
    if (!status && to_world.item) {
        float checked[9];
        for (int i = 0; i < 9; i++) checked[i] = (float)out->R[i];
        status = rotation_check(c, checked, to_world.name);
        if (!status) inverted(out->R, out->T);
    }
    return status;
}

sherf_status parse_distortion(context *c, const value *v, double D[DISTORTION_MAX]) {
    static const int8_t counts[] = {0, 4, 5, 8, 12, 14};
    const int64_t n = value_numbers(v);
    memset(D, 0, DISTORTION_MAX * sizeof *D);
    if (!v || v->kind == VALUE_NONE) return SHERF_OK;
    for (size_t i = 0; i < COUNT_OF(counts); i++)
        if (n == counts[i]) return value_doubles(c, v, "D", (size_t)n, D);
    if (n < 0) return failure(c, SHERF_BAD_FILE, "D is not made of numbers");
    return failure(
        c, SHERF_BAD_FILE,
        "D has %lld numbers: OpenCV's distortion has 0, 4, 5, 8, 12 or 14 (a fisheye's is another, "
        "undistort the picture first)",
        (long long)n);
}

static sherf_status side_of(context *c, named_value n, int *out) {
    int64_t side = 0;
    sherf_status status = n.item ? value_integer(c, n.item, n.name, &side) : SHERF_OK;
    if (!status && (side < 0 || side > IMAGE_SIDE_MAX))
        status = failure(c, SHERF_BAD_FILE, "%s: %lld pixels", n.name, (long long)side);
    *out = (int)side;
    return status;
}

static sherf_status parse_all(context *c, const value *v, const int size[2], parsed_camera *out) {
    sherf_status status = K_of(c, v, size, out->K);
    if (!status) status = place_of(c, v, out);
    if (!status) status = parse_distortion(c, value_first(v, D_names).item, out->D);
    if (!status) status = side_of(c, value_first(v, width_names), &out->width);
    if (!status) status = side_of(c, value_first(v, height_names), &out->height);
    return status;
}

sherf_status parse_camera(context *c, const value *v, const int size[2], parsed_camera *out) {
    *out = (parsed_camera){.K = {0, 0, 0, 0, 0, 0, 0, 0, 1}, .R = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    if (size) out->K[2] = size[0] / 2., out->K[5] = size[1] / 2.;
    sherf_status status = parse_all(c, v, size, out);
    if (status) return failure_prefix(c, status, "camera");
    return parsed_camera_check(c, out);
}

sherf_status parsed_camera_placed(context *c, const parsed_camera *camera) {
    if (camera->turned && camera->moved) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "camera: %s is missing", camera->turned ? "T" : "R");
}

bool camera_is(const value *v) {
    return value_first(v, K_names).item || value_first(v, focal_names).item ||
           value_first(v, focal_x_names).item || value_first(v, field_names).item;
}

void camera_warn(context *c, const value *v, const parsed_camera *camera, const char *what) {
    const char *known[100];
    size_t n = 0;
    for (size_t i = 0; i < COUNT_OF(all_names); i++)
        for (const char *const *name = all_names[i]; *name && n + 1 < COUNT_OF(known); name++)
            known[n++] = *name;
    known[n] = NULL;
    unknown_keys_warn(c, v, known, what);
    if (camera && camera->turned && !camera->moved)
        log_line(c, SHERF_LOG_WARNING, "%s: R without T: it stands at the world's origin", what);
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
    for (int i = 0; i < DISTORTION_MAX; i++)
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
