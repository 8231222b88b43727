/* baseline: pictures that need no network, to compare a model's scores with.
 * - mean colour: inside the true mask the mean colour of the observed person, black elsewhere;
 * - painted body: the posed body mesh, each vertex in the colour of the observed picture where it was
 * seen. */
#ifndef SHERF_BASELINE_H
#define SHERF_BASELINE_H

#include "data/data.h"

typedef struct {
    float mean_color[3];
    float *color;  /* V x 3: seen, else that of the mirrored vertex if seen, else of the nearest seen in rest
                      pose */
    int32_t *seen; /* V: 1 if the vertex faces the camera, nothing hides it and it is inside the mask */
} baselines;
sherf_status baselines_create(context *c, const body_model *body, const sherf_observation *o, baselines *out);
void baselines_free(baselines *y); /* its arrays; fine on zeroes */

/* Draws them into out, H x W x 3 of the target. */
void baseline_mean_color(const baselines *y, const data_view *target, float *out);
sherf_status baseline_painted_body(context *c, const baselines *y, const body_model *body,
                                   const sherf_camera *camera, const sherf_pose *pose, float *out);

#endif
