/* Reads cameras from values: K, R, T and D under the names and in the forms of various tools. */
#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/parse.h"

static const char *const K_names[] = {
    "K", "intrinsic", "intrinsics", "cam_intrinsics", "intrinsic_matrix", "camera_matrix", "intrins", NULL};
static const char *const focal_names[] = {"focal_px",  "focal",  "focal_length", "focal_l", "f",
                                          "img_focal", "focals", "camera_f",     NULL};
static const char *const focal_x_names[] = {"fx", "fl_x", NULL}, *const focal_y_names[] = {"fy", "fl_y",
                                                                                           NULL};
static const char *const centre_names[] = {"princpt", "principal_point", "camera_center", "center",
                                           "c",       "img_center",      "camera_c",      NULL};
static const char *const centre_x_names[] = {"cx", NULL}, *const centre_y_names[] = {"cy", NULL};
static const char *const field_names[] = {"fov_deg", NULL};
/* Radians: across, and up and down. */
static const char *const angle_x_names[] = {"camera_angle_x", NULL}, *const angle_y_names[] = {
                                                                         "camera_angle_y", "yfov", NULL};
static const char *const R_names[] = {"R",   "Rvec",      "rvec", "rotation", "cam_R", "camera_rotation",
                                      "Rot", "camera_rt", NULL};
static const char *const T_names[] = {
    "T", "t", "Tvec", "tvec", "trans", "cam_t", "translation", "camera_translation", "camera_t", NULL};
static const char *const to_camera_names[] = {
    "RT",  "Rt",        "extrinsic",       "extrinsics",     "extri",
    "w2c", "world2cam", "world_to_camera", "cam_extrinsics", "extrinsic_matrix",
    NULL};
static const char *const to_world_names[] = {"c2w", "cam2world", "camera_to_world", "cam_to_world", NULL};
/* OpenGL's axes, x to the right, y up, z backward: NeRF's transforms.json, Blender. */
static const char *const gl_to_world_names[] = {"transform_matrix", "matrix_world", NULL};
/* COLMAP's, with the real part first; the position of a camera whose rotation is camera to world (3D Gaussian
 * splatting's cameras.json). */
static const char *const quaternion_names[] = {"qvec", NULL}, *const position_names[] = {"position", NULL};
static const char *const D_names[] = {
    "D",          "distortion",  "dist",     "dist_coeffs", "distCoeffs", "distortion_coefficients",
    "dist_coeff", "distortions", "distCoef", "camera_k",    NULL};
static const char *const lens_names[] = {"k1", "k2", "p1", "p2", "k3", NULL};
static const char *const width_names[] = {"width", "w", "W", "image_width", NULL}, *const height_names[] = {
                                                                                       "height", "h", "H",
                                                                                       "image_height", NULL};
static const char *const idle_names[] = {"id", "comment", NULL};
static const char *const model_names[] = {"camera_model", "is_fisheye", NULL};
static const char *const label_names[] = {"name", "img_name", "file_path", NULL};

static const char *const *const all_names[] = {
    K_names,        focal_names,       focal_x_names,    focal_y_names,  centre_names,    centre_x_names,
    centre_y_names, field_names,       R_names,          T_names,        to_camera_names, to_world_names,
    D_names,        width_names,       height_names,     idle_names,     label_names,     angle_x_names,
    angle_y_names,  gl_to_world_names, quaternion_names, position_names, lens_names,      model_names};

bool camera_is(const value *v) {
    return value_first(v, K_names).item || value_first(v, focal_names).item ||
           value_first(v, focal_x_names).item || value_first(v, field_names).item ||
           value_first(v, angle_x_names).item || value_first(v, angle_y_names).item;
}

static bool is_among(const char *key, const char *const *names) {
    while (*names && strcmp(key, *names)) names++;
    return *names != NULL;
}

/* ---- several cameras in one dict, each entry an array with one more axis ---- */

/* Numbers of one camera's entry, up to 0; the entries in the order in which they show how many there are. */
static const struct {
    const char *const *names;
    int8_t numbers[6];
} stacked[] = {
    {K_names, {9, 12, 16}},
    {to_camera_names, {12, 16}},
    {to_world_names, {12, 16}},
    {gl_to_world_names, {12, 16}},
    {R_names, {9}},
    {quaternion_names, {4}},
    {T_names, {3}},
    {position_names, {3}},
    {D_names, {4, 5, 8, 12, 14}},
};

/* Whether the entry is `count` times what one camera has there. */
static bool is_stack(named_value n, size_t kind, int64_t count) {
    const int64_t all = value_numbers(n.item);
    if (count < 1 || parse_rows(n.item) != count) return false;
    for (const int8_t *one = stacked[kind].numbers; *one; one++)
        if (all == count * *one) return true;
    return false;
}

int64_t camera_stack(const value *v) {
    if (!v || v->kind != VALUE_DICT) return 1;
    for (size_t k = 0; k < COUNT_OF(stacked) - 1; k++) {
        const named_value n = value_first(v, stacked[k].names);
        const int64_t count = n.item ? parse_rows(n.item) : 0;
        const value row = count > 1 ? parse_row_of(n.item, 0) : (value){.kind = VALUE_NONE};
        const bool nested = row.kind == VALUE_LIST || (row.kind == VALUE_ARRAY && row.array.rank > 0);
        if (nested && is_stack(n, k, count)) return count;
    }
    return 1;
}

value camera_unstack(const value *v, int64_t count, int64_t i, value_pair *pair, value *item) {
    const size_t n = v->dict.count;
    memcpy(pair, v->dict.pair, n * sizeof *pair);
    for (size_t p = 0; p < n; p++) {
        const char *key = pair[p].key->kind == VALUE_STRING ? pair[p].key->string.text : "";
        for (size_t k = 0; k < COUNT_OF(stacked); k++) {
            if (!is_among(key, stacked[k].names) || !is_stack((named_value){key, pair[p].item}, k, count))
                continue;
            item[p] = parse_row_of(pair[p].item, (size_t)i);
            pair[p].item = &item[p];
            break;
        }
    }
    return (value){.kind = VALUE_DICT, .dict = {pair, n}};
}

/* Whether a key is read. */
static bool camera_key(const char *key) {
    for (size_t i = 0; i < COUNT_OF(all_names); i++)
        if (is_among(key, all_names[i])) return true;
    return false;
}

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

/* 3 x 3, fx fy cx cy, or the corner of 3 x 4 or 4 x 4. */
static sherf_status K_whole(context *c, named_value n, double K[9]) {
    double four[4], wide[16];
    const int64_t numbers = value_numbers(n.item);
    if (numbers == 12 || numbers == 16) {
        sherf_status status = value_doubles(c, n.item, n.name, (size_t)numbers, wide);
        for (int i = 0; i < 9; i++) K[i] = wide[i / 3 * 4 + i % 3];
        if (!status && (wide[3] != 0 || wide[7] != 0))
            status = failure(c, SHERF_BAD_FILE, "%s: 3 x 4, but its last column is not 0", n.name);
        return status;
    }
    if (numbers != 4) return value_doubles(c, n.item, n.name, 9, K);
    sherf_status status = value_doubles(c, n.item, n.name, 4, four);
    K[0] = four[0], K[4] = four[1], K[2] = four[2], K[5] = four[3];
    return status;
}

static sherf_status K_field(context *c, named_value n, const int size[2], double K[9]) {
    double degrees;
    sherf_status status = number_of(c, n, &degrees);
    if (!status && !(degrees > 0.1 && degrees < 179))
        status = failure(c, SHERF_BAD_FILE, "fov_deg should lie between 0.1 and 179");
    if (!status && degrees < 1.6)
        status = failure(c, SHERF_BAD_FILE, "fov_deg is %g: are these radians?", degrees);
    if (!status) K[0] = K[4] = size[1] / 2. / tan(degrees * 3.14159265358979323846 / 360);
    return status;
}

/* A field of view in radians, across `side` pixels. */
static sherf_status K_angle(context *c, named_value n, int side, double K[9]) {
    double angle;
    sherf_status status = number_of(c, n, &angle);
    if (!status && !(angle > 0.002 && angle < 3.12))
        status = failure(c, SHERF_BAD_FILE, "%s is %g: radians are expected", n.name, angle);
    if (!status) K[0] = K[4] = side / 2. / tan(angle / 2);
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

/* K, or focal lengths, or a vertical field of view; the centre is the picture's middle by default. */
static sherf_status K_of(context *c, const value *v, const int size[2], double K[9]) {
    const named_value whole = value_first(v, K_names), focal = value_first(v, focal_names),
                      x = value_first(v, focal_x_names), y = value_first(v, focal_y_names),
                      field = value_first(v, field_names);
    const named_value across = value_first(v, angle_x_names), along = value_first(v, angle_y_names);
    double two[2];
    sherf_status status = SHERF_OK;
    if (whole.item) return K_whole(c, whole, K);
    if (focal.item && value_get(v, "sensor_width"))
        return failure(c, SHERF_BAD_FILE, "%s beside sensor_width is in millimetres: pixels are expected",
                       focal.name);
    if (!size) return keys_missing(c, v, "K is missing");
    if (field.item) return K_field(c, field, size, K);
    if (!focal.item && !x.item && (across.item || along.item)) {
        status = across.item ? K_angle(c, across, size[0], K) : K_angle(c, along, size[1], K);
        return status ? status : centre_of(c, v, K);
    }
    if (!focal.item && !x.item) return keys_missing(c, v, "needs K, fov_deg or focal_px");
    status = focal.item ? pair_of(c, focal, two) : pair_of(c, x, two);
    if (!status && !focal.item && y.item) status = number_of(c, y, &two[1]);
    if (!status) K[0] = two[0], K[4] = two[1];
    return status ? status : centre_of(c, v, K);
}

/* Inverts x = R x' + T: R^T, -R^T T. */
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

/* qvec: w x y z. */
static sherf_status quaternion_of(context *c, named_value n, double R[9]) {
    double q[4], length = 0;
    sherf_status status = value_doubles(c, n.item, n.name, 4, q);
    for (int k = 0; k < 4 && !status; k++) length += q[k] * q[k];
    if (!status && !(fabs(length - 1) < 0.05))
        status = failure(c, SHERF_BAD_FILE, "%s: a quaternion of length %g", n.name, sqrt(length));
    if (status) return status;
    for (int k = 0; k < 4; k++) q[k] /= sqrt(length);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            const double twist = i == j ? 0 : (j == (i + 1) % 3 ? -1 : 1) * q[0] * q[1 + (3 - i - j)];
            R[3 * i + j] = (i == j ? 2 * (q[0] * q[0]) - 1 : 0) + 2 * (q[1 + i] * q[1 + j] + twist);
        }
    return SHERF_OK;
}

/* Inverts a camera's pose in the world; gl: with OpenGL's axes. */
static sherf_status from_world(context *c, const char *name, bool gl, parsed_camera *out) {
    float checked[9];
    for (int i = 0; i < 9 && gl; i++)
        if (i % 3) out->R[i] = -out->R[i];
    for (int i = 0; i < 9; i++) checked[i] = (float)out->R[i];
    sherf_status status = rotation_check(c, checked, name);
    if (!status) inverted(out->R, out->T);
    return status;
}

static sherf_status place_of(context *c, const value *v, parsed_camera *out) {
    const named_value quaternion = value_first(v, quaternion_names),
                      position = value_first(v, position_names);
    named_value R = value_first(v, R_names), T = value_first(v, T_names);
    const named_value to_camera = value_first(v, to_camera_names), gl = value_first(v, gl_to_world_names),
                      cv_to_world = value_first(v, to_world_names), to_world = gl.item ? gl : cv_to_world;
    const bool splat = !T.item && position.item && value_numbers(R.item) == 9; /* R is camera to world, too */
    if (gl.item && R.item && value_numbers(R.item) < 0) R.item = NULL; /* a step, in NeRF's own files */
    if (!R.item) R = quaternion;
    if (splat) T = position;
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
    if (!status && R.item)
        status = R.item == quaternion.item ? quaternion_of(c, R, out->R) : R_of(c, R, out->R);
    if (!status && T.item) status = value_doubles(c, T.item, T.name, 3, out->T);
    if (!status && (to_world.item || splat))
        status = from_world(c, splat ? R.name : to_world.name, gl.item != NULL, out);
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

/* A list of coefficients, or one by one. */
static sherf_status D_of(context *c, const value *v, double D[DISTORTION_MAX]) {
    const value *whole = value_first(v, D_names).item;
    sherf_status status = parse_distortion(c, whole, D);
    for (int i = 0; lens_names[i] && !whole && !status; i++) {
        const named_value one = {lens_names[i], value_get(v, lens_names[i])};
        if (one.item && one.item->kind != VALUE_NONE) status = number_of(c, one, &D[i]);
    }
    return status;
}

static sherf_status side_of(context *c, named_value n, int *out) {
    int64_t side = 0;
    sherf_status status = n.item ? value_integer(c, n.item, n.name, &side) : SHERF_OK;
    if (!status && (side < 0 || side > IMAGE_SIDE_MAX))
        status = failure(c, SHERF_BAD_FILE, "%s: %lld pixels", n.name, (long long)side);
    *out = (int)side;
    return status;
}

/* Keys that are not read, though they may contain missing data: a matrix, or numbers under the name of a
 * position. */
static sherf_status unread_place(context *c, const value *v, const parsed_camera *camera) {
    static const char *const words[] = {"pos",   "rot",    "quat", "trans",  "loc",
                                        "euler", "orient", "eye",  "target", "cent"};
    for (size_t i = 0; v && v->kind == VALUE_DICT && i < v->dict.count; i++) {
        const value *key = v->dict.pair[i].key;
        const int64_t numbers = value_numbers(v->dict.pair[i].item);
        const char *text = key->kind == VALUE_STRING ? key->string.text : NULL;
        if (!text || (camera->turned && camera->moved) ||
            (camera_key(text) && !(numbers == 3 && is_among(text, centre_names))) || *text == 'K' ||
            *text == 'i')
            continue;
        bool named = !strcmp(text, "C");
        for (size_t k = 0; k < COUNT_OF(words); k++) named |= strcasestr(text, words[k]) != NULL;
        if (numbers == 9 || numbers == 12 || numbers == 16 || (named && (numbers == 3 || numbers == 4)))
            return failure(
                c, SHERF_BAD_FILE,
                "%s of %lld numbers is not read: where the camera stands is told by R and T, RT (world to "
                "camera), c2w, or transform_matrix (OpenGL's axes)",
                text, (long long)numbers);
    }
    return SHERF_OK;
}

/* Nerfstudio's and instant-ngp's words on the lens: k1, k2, ... of a fisheye are not OpenCV's. */
static sherf_status model_check(context *c, const value *v) {
    static const char *const pinhole[] = {"OPENCV", "PINHOLE",     "SIMPLE_PINHOLE", "SIMPLE_RADIAL",
                                          "RADIAL", "FULL_OPENCV", "PERSPECTIVE",    NULL};
    const value *model = value_get(v, "camera_model"), *fisheye = value_get(v, "is_fisheye");
    char name[64] = "";
    if (model && model->kind == VALUE_STRING) snprintf(name, sizeof name, "%.60s", model->string.text);
    for (char *p = name; *p; p++) *p = (char)toupper((unsigned char)*p);
    if (*name && !is_among(name, pinhole))
        return failure(
            c, SHERF_UNSUPPORTED,
            "camera_model %.60s: only pinhole cameras with OpenCV's distortion are read; undistort "
            "the picture first",
            model->string.text);
    if (fisheye && fisheye->kind == VALUE_BOOL && fisheye->boolean)
        return failure(c, SHERF_UNSUPPORTED, "a fisheye (is_fisheye): undistort the picture first");
    return SHERF_OK;
}

/* Focal lengths in millimetres, or relative to the picture's side, would be a few pixels. */
static sherf_status view_check(context *c, const double K[9], const int size[2]) {
    static const double least = 0.1; /* of the longer side: 157 degrees */
    const int longer = size[0] > size[1] ? size[0] : size[1];
    const double focal = fmin(fabs(K[0]), fabs(K[4]));
    if (!(focal > 1e-6) || focal >= least * longer) return SHERF_OK; /* reported as a singular K */
    return failure(
        c, SHERF_BAD_FILE,
        "a focal length of %.3g pixels for a picture of %d x %d, which no lens has: is it in millimetres, or "
        "in parts of the picture?",
        focal, size[0], size[1]);
}

/* shared: values for all cameras of a file; the camera's own values have priority. */
static sherf_status parse_all(context *c, const value *v, const value *shared, const int size[2],
                              parsed_camera *out) {
    const value *lens = shared && !camera_is(v) ? shared : v,
                *nested = value_unwrapped(value_first(lens, K_names).item),
                *place = value_unwrapped(value_first(v, to_camera_names).item);
    double none[DISTORTION_MAX] = {0};
    sherf_status status = model_check(c, v);
    if (!status && shared) status = model_check(c, shared);
    if (!status) status = side_of(c, value_first(v, width_names), &out->width);
    if (!status) status = side_of(c, value_first(v, height_names), &out->height);
    if (!status && !out->width && shared) status = side_of(c, value_first(shared, width_names), &out->width);
    if (!status && !out->height && shared)
        status = side_of(c, value_first(shared, height_names), &out->height);
    const int own[2] = {out->width, out->height}, *sides = size                        ? size
                                                           : out->width && out->height ? own
                                                                                       : NULL;
    if (sides) out->K[2] = sides[0] / 2., out->K[5] = sides[1] / 2.;
    if (!status) status = K_of(c, nested && nested->kind == VALUE_DICT ? nested : lens, sides, out->K);
    if (!status && size) status = view_check(c, out->K, size);
    if (!status) status = place_of(c, place && place->kind == VALUE_DICT ? place : v, out);
    if (!status) status = unread_place(c, v, out);
    if (!status) status = D_of(c, v, out->D);
    if (!status && shared && !memcmp(out->D, none, sizeof none)) status = D_of(c, shared, out->D);
    return status;
}

void parsed_camera_name(parsed_camera *camera, const char *name) {
    const size_t length = strlen(name);
    const bool fits = length < sizeof camera->name;
    memcpy(camera->name, fits ? name : "", fits ? length + 1 : 1);
}

sherf_status parse_camera(context *c, const value *v, const value *shared, const int size[2],
                          parsed_camera *out) {
    *out = (parsed_camera){.K = {0, 0, 0, 0, 0, 0, 0, 0, 1}, .R = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    const value *label = value_first(v, label_names).item;
    if (label && label->kind == VALUE_STRING) parsed_camera_name(out, label->string.text);
    sherf_status status = parse_all(c, v, shared, size, out);
    if (status) return failure_prefix(c, status, "camera");
    return parsed_camera_check(c, out);
}

sherf_status parsed_camera_placed(context *c, const parsed_camera *camera) {
    if (camera->turned && camera->moved) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "camera: %s is missing", camera->turned ? "T" : "R");
}

void camera_warn(context *c, const value *v, const parsed_camera *camera, const char *what) {
    const char *known[160];
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
        if (!isfinite((float)K[i]) || !isfinite((float)camera->R[i])) /* 1e39 is not finite either */
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
        return failure(c, SHERF_BAD_FILE, "camera: K's last row is not 0 0 1%s",
                       K[2] == 0 && K[5] == 0 && fabs(K[8] - 1) < 1e-9
                           ? ", its last column is: this is the transposed matrix"
                           : "");
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
