/* Rotations as files store them: axis-angle, quaternions, matrices, and matrices' first two rows or columns.
 */
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
    case SHERF_ROTATIONS_6D_ROWS:
    case SHERF_ROTATIONS_6D_COLUMNS:
        return SIX;
    default:
        return 3;
    }
}

/* One frame's numbers: `joints` joints with `per` (3, 4, 6 or 9) numbers each. */
typedef struct {
    int joints, per;
    sherf_rotations form; /* AUTO: six numbers, rows or columns */
    six_form six;
} rotation_form;

sherf_rotations rotation_said(const body_parts *p, sherf_rotations given) {
    if (given != SHERF_ROTATIONS_AUTO || !p->six) return given;
    return p->six == SIX_ROWS ? SHERF_ROTATIONS_6D_ROWS : SHERF_ROTATIONS_6D_COLUMNS;
}

/* Determined by the count of numbers in a frame; joints: possible numbers of joints, a list that ends with
 * 0. What a file says of six numbers is no word on others. */
static sherf_status rotation_form_find(context *c, const char *what, const value *frame, const int *joints,
                                       sherf_rotations given, rotation_form *out) {
    static const sherf_rotations forms[] = {SHERF_ROTATIONS_AXIS_ANGLE, SHERF_ROTATIONS_WXYZ,
                                            SHERF_ROTATIONS_MATRIX};
    const int64_t numbers = value_numbers(frame);
    for (size_t f = 0; f < COUNT_OF(forms); f++)
        for (const int *j = joints; *j; j++) {
            sherf_rotations form = given == SHERF_ROTATIONS_AUTO ? forms[f] : given;
            int per = numbers_of(form);
            if (numbers != (int64_t)*j * per) continue;
            *out = (rotation_form){*j, per, form, {SIX_UNKNOWN, false}};
            return SHERF_OK;
        }
    const int sixes = given == SHERF_ROTATIONS_AUTO ? six_joints(frame, joints) : 0;
    *out = (rotation_form){sixes, SIX, SHERF_ROTATIONS_AUTO, {SIX_UNKNOWN, false}};
    if (sixes) return SHERF_OK;
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

static six_kind kind_of(sherf_rotations form) {
    return form == SHERF_ROTATIONS_6D_ROWS      ? SIX_ROWS
           : form == SHERF_ROTATIONS_6D_COLUMNS ? SIX_COLUMNS
                                                : SIX_UNKNOWN;
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
    } else if (f->per == SIX) {
        double R[9];
        sherf_status status = six_matrix(c, what, &f->six, v, R);
        if (status) return status;
        quaternion_from_matrix(R, q);
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

/* Frame i of rows, or the only one. */
static sherf_status frame_numbers(context *c, const char *what, const value *v, bool one, int i, int count,
                                  double *numbers) {
    return one ? value_doubles(c, v, what, (size_t)count, numbers)
               : parse_row(c, v, (size_t)i, what, (size_t)count, numbers);
}

/* What six numbers a joint are, as all frames together show. */
static sherf_status six_of_rows(context *c, const char *what, const value *v, bool one, int frames, int first,
                                sherf_rotations given, rotation_form *f) {
    double numbers[ROTATION_JOINTS_MAX * 9];
    six_evidence shown = {0};
    for (int i = 0; i < frames && f->per == SIX; i++) {
        sherf_status status = frame_numbers(c, what, v, one, i, f->joints * SIX, numbers);
        if (status) return status;
        six_add(&shown, numbers, f->joints, first);
    }
    return f->per == SIX ? six_decide(c, what, &shown, kind_of(given), &f->six) : SHERF_OK;
}

sherf_rotations rotation_root_form(context *c, const value *body, const value *root, int64_t frames,
                                   const int *joints, sherf_rotations given) {
    double numbers[ROTATION_JOINTS_MAX * 9];
    const int64_t n = value_numbers(root);
    if (given != SHERF_ROTATIONS_AUTO || frames < 1 || (n != 4 * frames && n != SIX * frames)) return given;
    rotation_form f = {0};
    const bool one = frames == 1 && parse_rows(body) != 1;
    if (!one && parse_rows(body) != frames) return given;
    const value own = one ? *body : parse_row_of(body, 0);
    if (rotation_form_find(c, "body", &own, joints, given, &f) || n != f.per * frames) return given;
    if (f.per == SIX) {
        if (six_of_rows(c, "body", body, one, (int)frames, 1, given, &f)) return given;
        return f.six.kind == SIX_ROWS ? SHERF_ROTATIONS_6D_ROWS : SHERF_ROTATIONS_6D_COLUMNS;
    }
    if (value_doubles(c, &own, "body", (size_t)(4 * f.joints), numbers)) return given;
    rotation_form_guess(&f, given, numbers);
    return f.form;
}

sherf_status rotation_frame(context *c, const char *what, const value *v, sherf_rotations given,
                            const int *joints, int first, int max, float (*turn)[4]) {
    double numbers[ROTATION_JOINTS_MAX * 9];
    rotation_form f = {0};
    int64_t n = value_numbers(v), counted = 0;
    double squares = 0;
    sherf_status status = rotation_form_find(c, what, v, joints, given, &f);
    if (!status) status = joints_last_check(c, what, v, f.joints);
    if (!status) status = value_doubles(c, v, what, (size_t)n, numbers);
    if (!status) status = six_of_rows(c, what, v, true, 1, first, given, &f);
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
    const value frame = one ? *v : parse_row_of(v, 0);
    sherf_status status = rotation_form_find(c, what, &frame, joints, given, &f);
    if (!status) status = joints_last_check(c, what, v, f.joints);
    if (!status) status = six_of_rows(c, what, v, one, k->frames, first, given, &f);
    if (!status && f.per == SIX && given == SHERF_ROTATIONS_AUTO) six_log(c, what, &f.six);
    for (int i = 0; i < k->frames && !status; i++) {
        status = frame_numbers(c, what, v, one, i, f.joints * f.per, numbers);
        if (!i && !status) rotation_form_guess(&f, given, numbers);
        for (int j = 0; j < f.joints && j < max && !status; j++) {
            status = rotation_read(c, what, &f, numbers, j, k->turn[i][first + j]);
            turns_add(&f, numbers, j, &squares, &counted);
        }
    }
    return status ? status : radians_check(c, what, f.joints == 1, squares, counted);
}
