/* Vectors of three doubles. */
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

/* A vector without length stays as it is. */
static inline void unit3(double a[3]) {
    double length = sqrt(dot3(a, a));
    for (int k = 0; k < 3 && length > 0; k++) a[k] /= length;
}

#endif
