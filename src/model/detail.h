/* detail: what the observation shows and the network's colours do not, given back to frames. */
#ifndef SHERF_DETAIL_H
#define SHERF_DETAIL_H

#include "model/model.h"

/* The avatar's picture of the observed view rendered and compared. Free with detail_free. */
sherf_status detail_create(context *c, const sherf_avatar *a, const body_model *body, avatar_detail *out);
void detail_free(avatar_detail *d);
/* Into frame's colours; rays as the frame was made from, posed with its grid (points_prepare). */
void detail_apply(context *c, const sherf_avatar *a, const avatar_detail *d, const body_model *m,
                  const posed_body *posed, const ray_bundle *rays, sherf_frame *frame);

#endif
