/* Vectors of three doubles, and 3 x 3 matrices, row-major. */
#ifndef SHERF_VECTOR3_H
#define SHERF_VECTOR3_H

#include <math.h>
#include <string.h>

static inline double dot3(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* out may be a or b. */
static inline void cross3(const double a[3], const double b[3], double out[3]) {
    double x[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
    memcpy(out, x, sizeof x);
}

/* A zero vector stays as it is. */
static inline void unit3(double a[3]) {
    double length = sqrt(dot3(a, a));
    for (int k = 0; k < 3 && length > 0; k++) a[k] /= length;
}

/* out = R x, may be x. */
static inline void rotate3(const double R[9], const double x[3], double out[3]) {
    const double y[3] = {dot3(R, x), dot3(R + 3, x), dot3(R + 6, x)};
    memcpy(out, y, sizeof y);
}

/* out = a b, may be either. */
static inline void multiply3(const double a[9], const double b[9], double out[9]) {
    double m[9];
    for (int i = 0; i < 9; i++)
        m[i] = a[i / 3 * 3] * b[i % 3] + a[i / 3 * 3 + 1] * b[3 + i % 3] + a[i / 3 * 3 + 2] * b[6 + i % 3];
    memcpy(out, m, sizeof m);
}

#endif
