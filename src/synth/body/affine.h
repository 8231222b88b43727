/* Rotations (3 x 3) and affine maps (3 x 4), row-major doubles, for the rig. */
#ifndef SHERF_AFFINE_H
#define SHERF_AFFINE_H

#include <math.h>
#include <string.h>

#include "base/vector3.h"

static inline void turn3(const double axis[3], double angle_rad, double R[9]) {
    double s = sin(angle_rad), t = 1 - cos(angle_rad), a[3] = {axis[0], axis[1], axis[2]};
    unit3(a);
    double K[9] = {0, -a[2], a[1], a[2], 0, -a[0], -a[1], a[0], 0}, K2[9];
    multiply3(K, K, K2);
    for (int i = 0; i < 9; i++) R[i] = (i % 4 == 0) + s * K[i] + t * K2[i];
}

/* The smallest rotation from `from` to `to` (any lengths; opposite vectors turn about some axis). */
static inline void turn_to3(const double from[3], const double to[3], double R[9]) {
    double axis[3], some[3] = {0, 0, 1};
    cross3(from, to, axis);
    double sine = sqrt(dot3(axis, axis)), cosine = dot3(from, to);
    if (!(sine > 0)) {
        if (fabs(from[2]) > fabs(from[0]) + fabs(from[1])) some[0] = 1, some[2] = 0;
        cross3(from, some, axis);
    }
    turn3(axis, atan2(sine, cosine), R);
}

#endif
