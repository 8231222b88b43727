/* Rotations as files store them: axis-angle, quaternions, matrices. */
#include <math.h>
#include <string.h>

#include "motion/source.h"

static int numbers_of(sherf_rotations form) {
    switch (form) {
    case SHERF_ROTATIONS_MATRIX:
        return 9;
    case SHERF_ROTATIONS_WXYZ:
    case SHERF_ROTATIONS_XYZW:
        return 4;
    default:
        return 3;
    }
}

/* One frame's numbers: `joints` joints with `per` (3, 4 or 9) numbers each. */
typedef struct {
    int joints, per;
    sherf_rotations form; /* never AUTO */
} rotation_form;

/* Determined by the count of numbers in a frame; `first`: possible numbers of joints, a list that ends with
 * 0. */
static sherf_status rotation_form_find(context *c, const char *what, int64_t numbers, const int *joints,
                                       sherf_rotations given, rotation_form *out) {
    static const sherf_rotations forms[] = {SHERF_ROTATIONS_AXIS_ANGLE, SHERF_ROTATIONS_WXYZ,
                                            SHERF_ROTATIONS_MATRIX};
    for (size_t f = 0; f < COUNT_OF(forms); f++)
        for (const int *j = joints; *j; j++) {
            sherf_rotations form = given == SHERF_ROTATIONS_AUTO ? forms[f] : given;
            int per = numbers_of(form);
            if (numbers != (int64_t)*j * per) continue;
            *out = (rotation_form){*j, per, form};
            return SHERF_OK;
        }
    return failure(c, SHERF_BAD_FILE, "%s: %lld numbers a frame, which is no number of joints%s", what,
                   (long long)numbers,
                   given == SHERF_ROTATIONS_AUTO ? "" : " in the form of rotations requested");
}

/* The first frame shows whether the real part comes first (AUTO and 4 numbers). */
static void rotation_form_guess(rotation_form *f, sherf_rotations given, const double *numbers) {
    if (given != SHERF_ROTATIONS_AUTO || f->per != 4) return;
    double first = 0, last = 0; /* most joints turn by less than a right angle */
    for (int j = 0; j < f->joints; j++) first += fabs(numbers[4 * j]), last += fabs(numbers[4 * j + 3]);
    f->form = last > first ? SHERF_ROTATIONS_XYZW : SHERF_ROTATIONS_WXYZ;
}

/* Joint i of the numbers to a quaternion. */
static sherf_status rotation_read(context *c, const char *what, const rotation_form *f, const double *numbers,
                                  int i, float q[4]) {
    const double *v = numbers + f->per * i;
    if (f->per == 3) {
        enum { TURNS_MAX = 16 };
        double max = fmax(fabs(v[0]), fmax(fabs(v[1]), fabs(v[2])));
        if (max > TURNS_MAX * 2 * M_PI)
            return failure(c, SHERF_BAD_FILE, "%s: a rotation of %g radians; are these degrees?", what, max);
        quaternion_from_axis_angle(v, q);
    } else if (f->per == 4) {
        double length = v[0] * v[0] + v[1] * v[1] + v[2] * v[2] + v[3] * v[3];
        if (!(fabs(length - 1) < 0.05))
            return failure(c, SHERF_BAD_FILE, "%s: a quaternion of length %g", what, sqrt(length));
        bool real_last = f->form == SHERF_ROTATIONS_XYZW;
        for (int k = 0; k < 4; k++) q[k] = (float)(v[real_last ? (k + 3) % 4 : k] / sqrt(length));
    } else {
        float R[9];
        for (int k = 0; k < 9; k++) R[k] = (float)v[k];
        if (!rotation_is_valid(R)) return failure(c, SHERF_BAD_FILE, "%s: not a rotation matrix", what);
        quaternion_from_matrix(v, q);
    }
    return SHERF_OK;
}

/* Squared lengths of axis-angles. */
static void turns_add(const rotation_form *f, const double *numbers, int j, double *squares, int64_t *count) {
    const double *v = numbers + 3 * j;
    if (f->per != 3) return;
    *squares += v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    ++*count;
}

sherf_rotations rotation_root_form(context *c, const value *body, const value *root, int64_t frames,
                                   const int *joints, sherf_rotations given) {
    double numbers[ROTATION_JOINTS_MAX * 9];
    const int64_t n = value_numbers(body);
    if (given != SHERF_ROTATIONS_AUTO || frames < 1 || value_numbers(root) != 4 * frames) return given;
    while (*joints && n != 4 * frames * *joints) joints++;
    if (!*joints) return given;
    const value own = frames > 1 ? parse_row_of(body, 0) : *body;
    if (value_doubles(c, &own, "body", (size_t)(4 * *joints), numbers)) return given;
    rotation_form f = {*joints, 4, SHERF_ROTATIONS_WXYZ};
    rotation_form_guess(&f, given, numbers);
    return f.form;
}

sherf_status rotation_frame(context *c, const char *what, const value *v, sherf_rotations given,
                            const int *joints, int first, int max, float (*turn)[4]) {
    double numbers[ROTATION_JOINTS_MAX * 9];
    rotation_form f = {0};
    int64_t n = value_numbers(v), counted = 0;
    double squares = 0;
    sherf_status status = rotation_form_find(c, what, n, joints, given, &f);
    if (!status) status = joints_last_check(c, what, v, f.joints);
    if (!status) status = value_doubles(c, v, what, (size_t)n, numbers);
    if (status) return status;
    rotation_form_guess(&f, given, numbers);
    for (int j = 0; j < f.joints && j < max && !status; j++) {
        status = rotation_read(c, what, &f, numbers, j, turn[first + j]);
        turns_add(&f, numbers, j, &squares, &counted);
    }
    return status ? status : radians_check(c, what, f.joints == 1, squares, counted);
}

sherf_status rotation_rows(context *c, const char *what, const value *v, sherf_rotations given,
                           const int *joints, int first, int max, clip *k) {
    double numbers[ROTATION_JOINTS_MAX * 9];
    rotation_form f = {0};
    int64_t n = value_numbers(v), counted = 0;
    double squares = 0;
    bool one = k->frames == 1 && parse_rows(v) != 1; /* a single frame without an axis for frames */
    if (n < 0 || n % k->frames || (!one && parse_rows(v) != k->frames))
        return failure(c, SHERF_BAD_FILE, "%s: %lld numbers are not one row for each of %d frames", what,
                       (long long)n, k->frames);
    sherf_status status = rotation_form_find(c, what, n / k->frames, joints, given, &f);
    if (!status) status = joints_last_check(c, what, v, f.joints);
    for (int i = 0; i < k->frames && !status; i++) {
        status = one ? value_doubles(c, v, what, (size_t)n, numbers)
                     : parse_row(c, v, (size_t)i, what, (size_t)(f.joints * f.per), numbers);
        if (!i && !status) rotation_form_guess(&f, given, numbers);
        for (int j = 0; j < f.joints && j < max && !status; j++) {
            status = rotation_read(c, what, &f, numbers, j, k->turn[i][first + j]);
            turns_add(&f, numbers, j, &squares, &counted);
        }
    }
    return status ? status : radians_check(c, what, f.joints == 1, squares, counted);
}
