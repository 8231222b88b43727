/* estimate: from a photo to an observation: finds the people (landmarks.h), the mask (mask.h), the camera and
 * the body (fit.h). */
#ifndef SHERF_ESTIMATE_ESTIMATE_H
#define SHERF_ESTIMATE_ESTIMATE_H

#include "data/data.h"
#include "estimate/fit.h"
#include "estimate/landmarks.h"

/* A photo's longer side is scaled down to this: observations are kept no larger either. */
enum { ESTIMATE_SIDE_MAX = 2048 };

struct sherf_estimator {
    pose_networks *networks;
};

struct sherf_estimate {
    sherf_image photo; /* RGB, the input of the estimate */
    sherf_image color; /* the same, with the person's own colours at the mask's edge */
    sherf_image mask;  /* [H, W, 1], soft */
    photo_person person;
    double focal_px; /* the given focal length; 0: none */
    body_fit_result fit;
    bool mask_over; /* of person_mask_facts */
    sherf_estimate_facts facts;
};

/* Writes a PNG of the photo, darkened outside the mask, with the body over it. */
sherf_status estimate_draw(context *c, const sherf_estimate *e, const body_model *body, const char *path);
#endif
