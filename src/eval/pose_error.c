/* Distances and angles between two skeletons. */
#include "eval/pose_error.h"

#include <math.h>
#include <string.h>

#include "base/vector3.h"

enum { LEFT_HIP = 1, RIGHT_HIP = 2, NECK = 12, LEFT_SHOULDER = 16, RIGHT_SHOULDER = 17 };

/* A vector without length stays 0. */
static void unit(double v[3]) {
    double length = sqrt(dot3(v, v));
    for (int k = 0; k < 3; k++) v[k] = length > 0 ? v[k] / length : 0;
}

static double degrees_between(const double a[3], const double b[3]) {
    double n[3];
    cross3(a, b, n);
    return atan2(sqrt(dot3(n, n)), dot3(a, b)) * 180 / M_PI;
}

/* ---- the similarity that fits best ---- */

/* The eigenvector of the largest eigenvalue of a symmetric matrix, by Jacobi's rotations. */
static void largest_eigenvector(double m[4][4], double out[4]) {
    double v[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    for (int sweep = 0; sweep < 30; sweep++)
        for (int p = 0; p < 3; p++)
            for (int q = p + 1; q < 4; q++) {
                if (m[p][q] == 0) continue;
                double theta = (m[q][q] - m[p][p]) / (2 * m[p][q]);
                double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 4; k++) { /* columns, then rows */
                    double a = m[k][p], b = m[k][q];
                    m[k][p] = c * a - s * b, m[k][q] = s * a + c * b;
                    a = v[k][p], b = v[k][q];
                    v[k][p] = c * a - s * b, v[k][q] = s * a + c * b;
                }
                for (int k = 0; k < 4; k++) {
                    double a = m[p][k], b = m[q][k];
                    m[p][k] = c * a - s * b, m[q][k] = s * a + c * b;
                }
            }
    int best = 0;
    for (int i = 1; i < 4; i++)
        if (m[i][i] > m[best][best]) best = i;
    for (int k = 0; k < 4; k++) out[k] = v[k][best];
}

static void middle_of(int n, const double (*x)[3], double out[3]) {
    memset(out, 0, 3 * sizeof *out);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) out[k] += x[i][k] / n;
}

/* S[a][b]: sum of x_a y_b about the middles. */
static void best_rotation(double S[3][3], double R[9]) {
    double q[4],
        m[4][4] = {{S[0][0] + S[1][1] + S[2][2], S[1][2] - S[2][1], S[2][0] - S[0][2], S[0][1] - S[1][0]},
                   {0, S[0][0] - S[1][1] - S[2][2], S[0][1] + S[1][0], S[2][0] + S[0][2]},
                   {0, 0, S[1][1] - S[0][0] - S[2][2], S[1][2] + S[2][1]},
                   {0, 0, 0, S[2][2] - S[0][0] - S[1][1]}};
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < i; k++) m[i][k] = m[k][i];
    largest_eigenvector(m, q);
    double w = q[0], x = q[1], y = q[2], z = q[3];
    const double rows[9] = {
        w * w + x * x - y * y - z * z, 2 * (x * y - w * z),           2 * (x * z + w * y),
        2 * (x * y + w * z),           w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
        2 * (x * z - w * y),           2 * (y * z + w * x),           w * w - x * x - y * y + z * z};
    memcpy(R, rows, sizeof rows);
}

double procrustes_distance(int n, const double (*x)[3], const double (*y)[3]) {
    double mx[3], my[3], S[3][3] = {{0}}, R[9], squares = 0, along = 0, sum = 0;
    middle_of(n, x, mx);
    middle_of(n, y, my);
    for (int i = 0; i < n; i++)
        for (int a = 0; a < 3; a++) {
            squares += (x[i][a] - mx[a]) * (x[i][a] - mx[a]);
            for (int b = 0; b < 3; b++) S[a][b] += (x[i][a] - mx[a]) * (y[i][b] - my[b]);
        }
    best_rotation(S, R);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) along += R[3 * b + a] * S[a][b];
    double scale = squares > 0 ? along / squares : 0;
    for (int i = 0; i < n; i++) {
        double d[3], at[3];
        for (int k = 0; k < 3; k++) at[k] = x[i][k] - mx[k];
        for (int k = 0; k < 3; k++) d[k] = scale * dot3(R + 3 * k, at) + my[k] - y[i][k];
        sum += sqrt(dot3(d, d)) / n;
    }
    return sum;
}

/* ---- the errors ---- */

/* Unit vectors: up along the trunk, and the direction that hips and shoulders face, at a right angle to it.
 */
static void trunk_of(const double (*joint)[3], double up[3], double facing[3]) {
    double left[3];
    for (int k = 0; k < 3; k++) {
        up[k] = joint[NECK][k] - 0.5 * (joint[LEFT_HIP][k] + joint[RIGHT_HIP][k]);
        left[k] =
            joint[LEFT_HIP][k] + joint[LEFT_SHOULDER][k] - joint[RIGHT_HIP][k] - joint[RIGHT_SHOULDER][k];
    }
    unit(up);
    cross3(left, up, facing);
    unit(facing);
}

void pose_error_measure(const float truth[BODY_JOINTS][3], const float estimate[BODY_JOINTS][3],
                        pose_error *out) {
    double t[BODY_JOINTS][3], e[BODY_JOINTS][3], up[3], facing[3], own_up[3], own_facing[3], flat[3];
    *out = (pose_error){.overlap = NAN};
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int k = 0; k < 3; k++) t[j][k] = (double)truth[j][k], e[j][k] = (double)estimate[j][k];
    for (int j = 1; j < BODY_JOINTS; j++) {
        double d[3];
        for (int k = 0; k < 3; k++) d[k] = (e[j][k] - e[0][k]) - (t[j][k] - t[0][k]);
        out->joints_mm += 1000 * sqrt(dot3(d, d)) / (BODY_JOINTS - 1);
    }
    out->aligned_mm = 1000 * procrustes_distance(BODY_JOINTS, e, t);
    trunk_of(t, up, facing);
    trunk_of(e, own_up, own_facing);
    out->lean_deg = degrees_between(up, own_up);
    out->forward_deg = atan2(dot3(own_up, facing), dot3(own_up, up)) * 180 / M_PI;
    for (int k = 0; k < 3; k++) flat[k] = own_facing[k] - dot3(own_facing, up) * up[k];
    out->turn_deg = degrees_between(facing, flat);
}

bool pose_error_wrong_way(const pose_error *e) {
    return e->turn_deg > 90;
}

double mask_overlap(size_t n, const uint8_t *a, const uint8_t *b) {
    size_t both = 0, either = 0;
    for (size_t i = 0; i < n; i++) {
        both += a[i] && b[i];
        either += a[i] || b[i];
    }
    return either ? (double)both / (double)either : 1;
}
