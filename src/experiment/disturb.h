/* disturb: bodies that are wrong on purpose, as an estimator's are. The observed camera and mask stay; the
 * pose, the shape and the distance change.
 *
 * All joints but the root get axis-angle noise of standard deviation s, the root a third of it, and the shape
 * 0.5 if s is not 0. The body comes up to 5 % nearer or farther, with its root on the same pixel. The noise
 * depends on the true body alone, so every method gets the same. */
#ifndef SHERF_DISTURB_H
#define SHERF_DISTURB_H

#include "eval/estimated.h"

typedef struct {
    const sherf_body *body;
    double deviation_rad;
} disturbance;
/* An eval_estimator's function: the state is a disturbance. */
sherf_status estimate_by_disturbance(context *c, void *state, const sherf_image *photo,
                                     const sherf_observation *truth, sherf_observation **out);
sherf_status disturbed_pose(context *c, const disturbance *d, const sherf_camera *camera,
                            const sherf_pose *truth, sherf_pose *out);
/* The standard deviation that moves joints by this many millimetres, after the best similarity (Procrustes),
 * averaged over these bodies; 0 for 0. */
sherf_status disturbance_for(context *c, const sherf_body *body, int bodies, const sherf_camera *camera,
                             const sherf_pose *truth, double aligned_mm, double *deviation_rad);

#endif
