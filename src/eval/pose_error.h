/* pose_error: how far an estimated body is from the true one, seen from the camera that observed it. */
#ifndef SHERF_POSE_ERROR_H
#define SHERF_POSE_ERROR_H

#include "body/body.h"

/* Joints are the body's 24 in metres, both bodies' in one frame: the observed camera's. */
typedef struct {
    double joints_mm;   /* mean distance of the 23 joints below the pelvis, pelvises aligned */
    double aligned_mm;  /* of all 24, after the rotation, scale and translation that fit best (Procrustes) */
    double lean_deg;    /* angle between the trunks: middle of the hips to neck */
    double forward_deg; /* its forward part, as the true person sees it; backward is negative */
    /* angle between the directions that hips and shoulders face, about the true trunk, 0 to 180 */
    double turn_deg;
    double overlap; /* of the masks: intersection over union; NaN: not compared */
} pose_error;
/* Everything but the overlap, which becomes NaN. */
void pose_error_measure(const float truth[BODY_JOINTS][3], const float estimate[BODY_JOINTS][3],
                        pose_error *out);
/* Front taken for back. */
bool pose_error_wrong_way(const pose_error *e);
/* Of masks of n pixels, not 0 is inside; 1 when both are empty. */
double mask_overlap(size_t n, const uint8_t *a, const uint8_t *b);

/* The similarity y = scale R x + shift that brings n points x nearest to y (Horn 1987, by the largest
 * eigenvector of his quaternion matrix). Returns the mean remaining distance. Where all of x are one point
 * the scale is 0. */
double procrustes_distance(int n, const double (*x)[3], const double (*y)[3]);

#endif
