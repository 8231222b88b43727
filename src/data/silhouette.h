/* The silhouette of the posed body: its overlap with a mask, and a drawing of it. */
#ifndef SHERF_DATA_SILHOUETTE_H
#define SHERF_DATA_SILHOUETTE_H

#include "data/data.h"

/* Intersection over union of the body's silhouette and the observation's mask, without uncertain pixels. The
 * camera and pose may differ from the observation's own (same size). The mask may be mirrored, or have person
 * and background swapped. */
typedef enum { MASK_AS_IT_IS, MASK_MIRRORED, MASK_INVERTED } mask_reading;
sherf_status silhouette_overlap(context *c, const sherf_observation *o, const body_model *body,
                                const sherf_pose *pose, const sherf_camera *camera, mask_reading reading,
                                double *overlap);
/* The body, shaded and half transparent, over the picture, as PNG; outside the mask the picture is grey. */
sherf_status silhouette_draw(context *c, const sherf_observation *o, const body_model *body,
                             const char *path);
#endif
