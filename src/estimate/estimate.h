/* estimate: from a photo to an observation: who is there (landmarks.h), where the person ends (mask.h), which
 * camera and body that is (fit.h). */
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
    sherf_image photo; /* RGB, as it was estimated from */
    sherf_image color; /* the same with the person's own colours at the rim */
    sherf_image mask;  /* [H, W, 1], soft */
    photo_person person;
    double focal_px; /* that was given; 0: none */
    body_fit_result fit;
    bool mask_over; /* of person_mask_facts */
    sherf_estimate_facts facts;
};

/* The person as body silhouette and mask show it: the photo, darker outside the mask, under the body. PNG. */
sherf_status estimate_draw(context *c, const sherf_estimate *e, const body_model *body, const char *path);
#endif
