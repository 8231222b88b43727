/* Rotations as six numbers: which layout they have, and to matrices. */
#include "data/six.h"

#include "base/vector3.h"

enum { AXES_MAX = 8 };

/* The axes of an array or of nested lists, by their first elements; -1: too many. */
static int axes_of(const value *v, int64_t dim[AXES_MAX]) {
    int n = 0;
    for (; v && v->kind == VALUE_LIST && v->list.count; v = v->list.item[0]) {
        if (n == AXES_MAX) return -1;
        dim[n++] = (int64_t)v->list.count;
    }
    for (int k = 0; v && v->kind == VALUE_ARRAY && k < v->array.rank; k++) {
        if (n == AXES_MAX) return -1;
        dim[n++] = v->array.dim[k];
    }
    return n;
}

int six_joints(const value *v, const int *joints) {
    int64_t dim[AXES_MAX];
    const int64_t n = value_numbers(v);
    const int axes = n >= SIX && n % SIX == 0 ? axes_of(v, dim) : 0;
    if (axes < 1) return 0;
    const int64_t last = dim[axes - 1], before = axes > 1 ? dim[axes - 2] : 1;
    if (last != SIX && last != n && !(last * before == SIX && last > 1 && before > 1)) return 0;
    while (*joints && n != (int64_t)*joints * SIX) joints++;
    return *joints;
}

six_kind six_said(const value *dict) {
    const value *word = value_get(dict, "rotations");
    if (value_is_string(word, "6d-rows")) return SIX_ROWS;
    return value_is_string(word, "6d-columns") ? SIX_COLUMNS : SIX_UNKNOWN;
}

/* The two vectors in the six numbers. */
static void vectors_of(const double six[SIX], bool woven, double a[3], double b[3]) {
    for (int k = 0; k < 3; k++) {
        a[k] = six[woven ? 2 * k : k];
        b[k] = six[woven ? 2 * k + 1 : 3 + k];
    }
}

/* Squared distance of the two vectors from orthonormal ones. */
static double distance_of(const double six[SIX], bool woven) {
    double a[3], b[3];
    vectors_of(six, woven, a, b);
    const double la = sqrt(dot3(a, a)), lb = sqrt(dot3(b, b)),
                 cosine = la > 1e-9 && lb > 1e-9 ? dot3(a, b) / (la * lb) : 1;
    const double distance = (la - 1) * (la - 1) + (lb - 1) * (lb - 1) + cosine * cosine;
    return distance < 1e6 ? distance : 1e6; /* and where it is no number */
}

/* The sine of the turn about an axis (0 x, 1 y) of the matrix whose first rows these are. */
static double turn_about(const double six[SIX], bool woven, int axis) {
    double a[3], b[3], c[3];
    vectors_of(six, woven, a, b);
    cross3(a, b, c);
    return axis ? (a[2] - c[0]) / 2 : (c[1] - b[2]) / 2;
}

void six_add(six_evidence *e, const double *numbers, int joints, int first) {
    /* Knees bend about x; elbows bend the forearms forwards, about y. */
    static const struct {
        int8_t joint, axis, sign;
    } hinge[] = {{4, 0, 1}, {5, 0, 1}, {18, 1, -1}, {19, 1, 1}};
    for (int j = 0; j < joints; j++) {
        e->apart += distance_of(numbers + SIX * j, false);
        e->woven += distance_of(numbers + SIX * j, true);
    }
    for (size_t i = 0; i < COUNT_OF(hinge); i++) {
        const int j = hinge[i].joint - first;
        if (j < 0 || j >= joints) continue;
        e->bend_apart += hinge[i].sign * turn_about(numbers + SIX * j, false, hinge[i].axis);
        e->bend_woven += hinge[i].sign * turn_about(numbers + SIX * j, true, hinge[i].axis);
    }
    e->joints += joints;
    e->frames++;
}

/* By the limbs: rows that bend backwards are columns. Interleaved numbers are columns in all tools that are
 * known, unless the limbs say otherwise. */
static six_kind kind_by_limbs(const six_evidence *e, bool woven) {
    static const double clear = 0.5; /* sine, of four joints together */
    const double bend = (woven ? e->bend_woven : e->bend_apart) / (double)e->frames;
    if (woven) return bend > clear ? SIX_UNKNOWN : SIX_COLUMNS;
    return bend > clear ? SIX_ROWS : bend < -clear ? SIX_COLUMNS : SIX_UNKNOWN;
}

sherf_status six_decide(context *c, const char *what, const six_evidence *e, six_kind said, six_form *out) {
    static const double far = 0.15;
    const double apart = sqrt(e->apart / (double)e->joints), woven = sqrt(e->woven / (double)e->joints);
    if (!(fmin(apart, woven) < far))
        return failure(c, SHERF_BAD_FILE,
                       "%s: six numbers a joint that are no two rows or columns of rotations (%.2g from "
                       "orthonormal): write matrices or axis-angles",
                       what, fmin(apart, woven));
    *out = (six_form){said, woven < apart};
    if (said) return SHERF_OK;
    out->kind = kind_by_limbs(e, out->woven);
    if (!out->kind)
        return failure(c, SHERF_BAD_FILE,
                       "%s: six numbers a joint, and knees and elbows do not show whether they are the "
                       "first two rows or columns of the matrices: say \"rotations\": \"6d-rows\" or "
                       "\"6d-columns\" beside them, or --rotations to animate",
                       what);
    return SHERF_OK;
}

void six_log(context *c, const char *what, const six_form *form) {
    log_line(c, SHERF_LOG_INFO, "%s: six numbers a joint, read as the first two %s of the matrices%s", what,
             form->kind == SIX_ROWS ? "rows" : "columns", form->woven ? "" : ", as knees and elbows bend");
}

sherf_status six_matrix(context *c, const char *what, const six_form *form, const double six[SIX],
                        double R[9]) {
    double row[3][3];
    if (!(distance_of(six, form->woven) < 0.25))
        return failure(c, SHERF_BAD_FILE, "%s: six numbers of a joint: not a rotation", what);
    vectors_of(six, form->woven, row[0], row[1]);
    const double length = sqrt(dot3(row[0], row[0])), along = dot3(row[0], row[1]) / (length * length);
    for (int k = 0; k < 3; k++) row[1][k] -= along * row[0][k], row[0][k] /= length;
    const double across = sqrt(dot3(row[1], row[1]));
    for (int k = 0; k < 3; k++) row[1][k] /= across;
    cross3(row[0], row[1], row[2]);
    for (int i = 0; i < 9; i++) R[i] = form->kind == SIX_ROWS ? row[i / 3][i % 3] : row[i % 3][i / 3];
    return SHERF_OK;
}
