/* Corrects the landmarks' depths. The network's are too short, bent at straight knees, and have correlated
 * errors, so each depth is corrected linearly by all (ridge regression over people with known bodies:
 * bench/fit_depths.c). */
#include <math.h>
#include <string.h>

#include "estimate/fit_inside.h"

/* The largest correction of a depth. */
static const double correction_max_m = 0.3;

static void turn(double cosine, double sine, const float at[2], double out[2]) {
    out[0] = cosine * (double)at[0] + sine * (double)at[1];
    out[1] = cosine * (double)at[1] - sine * (double)at[0];
}

bool fit_depth_numbers(const photo_person *p, double number[FIT_DEPTH_NUMBERS], double *px_per_m) {
    const double cosine = cos((double)p->region.angle_rad), sine = sin((double)p->region.angle_rad);
    const landmark *l = p->landmark;
    float hips[2];
    double along = 0, all = 0;
    for (int k = 0; k < 2; k++)
        hips[k] = 0.5f * (l[LANDMARK_LEFT_HIP].place_px[k] + l[LANDMARK_RIGHT_HIP].place_px[k]);
    for (int i = 0, n = 0; i < LANDMARKS; i++) {
        if (fit_landmarks[i].joint < 0) continue;
        double *x = number + 6 * n++, weight = 0.12 + 0.88 * (double)l[i].visible;
        const float at[2] = {l[i].place_px[0] - hips[0], l[i].place_px[1] - hips[1]};
        turn(cosine, sine, l[i].place_m, x);
        x[2] = (double)l[i].place_m[2];
        turn(cosine, sine, at, x + 3);
        x[5] = (double)l[i].visible - 0.5;
        for (int k = 0; k < 2; k++) along += weight * x[3 + k] * x[k], all += weight * x[k] * x[k];
    }
    number[FIT_DEPTH_NUMBERS - 1] = 1;
    *px_per_m = all > 1e-6 ? along / all : 0;
    if (!(*px_per_m > 1e-6)) return false;
    for (int n = 0; n < FIT_DEPTHS; n++)
        for (int k = 0; k < 2; k++)
            number[6 * n + 3 + k] = number[6 * n + 3 + k] / *px_per_m - number[6 * n + k];
    return true;
}

void fit_depths(const photo_person *p, double depth_m[LANDMARKS]) {
    double number[FIT_DEPTH_NUMBERS], px_per_m;
    const bool sound = fit_depth_numbers(p, number, &px_per_m);
    for (int i = 0, n = 0; i < LANDMARKS; i++) {
        depth_m[i] = 0;
        if (fit_landmarks[i].joint < 0) continue;
        double by = 0;
        for (int k = 0; k < FIT_DEPTH_NUMBERS && sound; k++) by += fit_depth_weights[n][k] * number[k];
        by *= FIT_DEPTH_UNIT;
        depth_m[i] = (double)p->landmark[i].place_m[2] + fmin(fmax(by, -correction_max_m), correction_max_m);
        n++;
    }
}
