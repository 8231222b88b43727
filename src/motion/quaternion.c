/* Unit quaternions, w x y z: stored as floats, computed in double. */
#include <math.h>
#include <string.h>

#include "motion/motion.h"

static void store(const double q[4], float out[4]) {
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++) out[i] = (float)(length > 0 ? q[i] / length : i == 0);
}

void quaternion_from_axis_angle(const double v[3], float q[4]) {
    double angle = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    double s = angle > 1e-12 ? sin(angle / 2) / angle : 0.5;
    store((const double[4]){cos(angle / 2), s * v[0], s * v[1], s * v[2]}, q);
}

/* Finds the largest component first, so that angles near pi stay exact. */
void quaternion_from_matrix(const double R[9], float q[4]) {
    double trace = R[0] + R[4] + R[8], p[4];
    if (trace > R[0] && trace > R[4] && trace > R[8]) {
        p[0] = 1 + trace;
        p[1] = R[7] - R[5], p[2] = R[2] - R[6], p[3] = R[3] - R[1];
    } else {
        int i = R[4] > R[0] ? 1 : 0;
        if (R[8] > R[4 * i]) i = 2;
        int j = (i + 1) % 3, k = (i + 2) % 3;
        p[0] = R[3 * k + j] - R[3 * j + k];
        p[1 + i] = 1 + R[4 * i] - R[4 * j] - R[4 * k];
        p[1 + j] = R[3 * i + j] + R[3 * j + i];
        p[1 + k] = R[3 * i + k] + R[3 * k + i];
    }
    store(p, q);
}

void quaternion_to_axis_angle(const float q[4], float v[3]) {
    double sine = sqrt((double)q[1] * q[1] + (double)q[2] * q[2] + (double)q[3] * q[3]);
    double sign = q[0] < 0 ? -1 : 1, angle = 2 * atan2(sine, sign * q[0]);
    double scale = sine > 1e-12 ? sign * angle / sine : 2 * sign; /* the limit at the identity */
    for (int k = 0; k < 3; k++) v[k] = (float)(scale * q[1 + k]);
}

void quaternion_to_matrix(const float q[4], double R[9]) {
    double w = q[0], x = q[1], y = q[2], z = q[3];
    const double m[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - z * w),     2 * (x * z + y * w),
                         2 * (x * y + z * w),     1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                         2 * (x * z - y * w),     2 * (y * z + x * w),     1 - 2 * (x * x + y * y)};
    memcpy(R, m, sizeof m);
}

void quaternion_multiply(const float a[4], const float b[4], float out[4]) {
    const double w = a[0], x = a[1], y = a[2], z = a[3];
    const double p[4] = {w * b[0] - x * b[1] - y * b[2] - z * b[3], w * b[1] + x * b[0] + y * b[3] - z * b[2],
                         w * b[2] - x * b[3] + y * b[0] + z * b[1],
                         w * b[3] + x * b[2] - y * b[1] + z * b[0]};
    store(p, out);
}

void quaternion_inverse(const float q[4], float out[4]) {
    out[0] = q[0];
    for (int i = 1; i < 4; i++) out[i] = -q[i];
}

static double dot(const float a[4], const float b[4]) {
    return (double)a[0] * b[0] + (double)a[1] * b[1] + (double)a[2] * b[2] + (double)a[3] * b[3];
}

void quaternion_slerp(const float a[4], const float b[4], double t, float out[4]) {
    double cosine = dot(a, b), sign = cosine < 0 ? -1 : 1, p[4];
    cosine *= sign;
    double from = 1 - t, to = t;
    if (cosine < 0.9999995) { /* closer than 0.1 degrees, the straight line is as good */
        double angle = acos(cosine), sine = sin(angle);
        from = sin((1 - t) * angle) / sine, to = sin(t * angle) / sine;
    }
    for (int i = 0; i < 4; i++) p[i] = from * a[i] + sign * to * b[i];
    store(p, out);
}

void quaternion_rotate(const float q[4], const double v[3], double out[3]) {
    double R[9], x = v[0], y = v[1], z = v[2];
    quaternion_to_matrix(q, R);
    for (int k = 0; k < 3; k++) out[k] = R[3 * k] * x + R[3 * k + 1] * y + R[3 * k + 2] * z;
}

double quaternion_angle(const float a[4], const float b[4]) {
    float back[4], d[4];
    quaternion_inverse(a, back);
    quaternion_multiply(back, b, d);
    double sine = sqrt((double)d[1] * d[1] + (double)d[2] * d[2] + (double)d[3] * d[3]);
    return 2 * atan2(sine, fabs((double)d[0]));
}
