/* The prior of poses. */
#include <math.h>
#include <string.h>

#include "estimate/fit_inside.h"

/* All but the root, and toes and hands, which are kept at rest. */
const int fit_pose_joint[FIT_POSE_JOINTS] = {1,  2,  3,  4,  5,  6,  7,  8,  9, 12,
                                             13, 14, 15, 16, 17, 18, 19, 20, 21};

/* The whitened residuals and their squares' sum; ends early where the sum exceeds `max`. */
static double off(const fit_pose_kind *g, const double x[FIT_POSE_NUMBERS], double max,
                  double r[FIT_POSE_NUMBERS]) {
    double away[FIT_POSE_NUMBERS], sum = 0;
    const int16_t *w = g->whiten;
    for (int i = 0; i < FIT_POSE_NUMBERS; i++) away[i] = x[i] - FIT_POSE_MEAN_UNIT * g->mean[i];
    for (int i = 0; i < FIT_POSE_NUMBERS && sum < max; i++) {
        r[i] = 0;
        for (int j = i; j < FIT_POSE_NUMBERS; j++) r[i] += *w++ * away[j];
        r[i] *= FIT_POSE_WHITEN_UNIT;
        sum += r[i] * r[i];
    }
    return sum;
}

const fit_pose_kind *fit_pose_nearest(const double x[FIT_POSE_NUMBERS], double r[FIT_POSE_NUMBERS],
                                      double *cost) {
    const fit_pose_kind *best = NULL;
    double other[FIT_POSE_NUMBERS];
    *cost = INFINITY;
    for (int k = 0; k < FIT_POSE_KINDS; k++) {
        const fit_pose_kind *g = &fit_pose_kinds[k];
        double own = g->cost + off(g, x, *cost - g->cost, other);
        if (!(own < *cost) && best) continue;
        *cost = own;
        best = g;
        memcpy(r, other, sizeof other);
    }
    return best;
}
