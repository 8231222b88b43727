/* The posed body as a camera sees it: how well it covers a mask, and a drawing of it. */
#ifndef SHERF_DATA_SILHOUETTE_H
#define SHERF_DATA_SILHOUETTE_H

#include "data/data.h"

/* Intersection over union of the body's silhouette and the observation's mask, uncertain pixels left out; the
 * camera and pose may differ from the observation's own (same size). mirror: against the mask seen in a
 * mirror. */
sherf_status silhouette_overlap(context *c, const sherf_observation *o, const body_model *body,
                                const sherf_pose *pose, const sherf_camera *camera, bool mirror,
                                double *overlap);
/* The body, shaded and half transparent, over the picture, as PNG; outside the mask the picture is grey. */
sherf_status silhouette_draw(context *c, const sherf_observation *o, const body_model *body,
                             const char *path);
#endif
