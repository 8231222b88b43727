/* region: squares of a photo as networks take them. */
#ifndef SHERF_ESTIMATE_REGION_H
#define SHERF_ESTIMATE_REGION_H

#include "estimate/person.h"

/* out [side, side, 3] = scale * value + shift. Where the region has more pixels than that, each of out is the
 * mean of what it covers (squares of whole pixels first, then four samples between those); else bilinear.
 * Outside the photo its nearest pixel, or black. The photo has 3 channels. */
sherf_status region_sample(context *c, const sherf_image *photo, const photo_region *region, int side,
                           bool black_outside, float scale, float shift, float *out);

/* (u, v) of the region to the photo, pixels. */
void region_place(const photo_region *region, float u, float v, float place_px[2]);
/* The square about `middle_px` that reaches 1.25 times as far as `top_px`, which shall be above the middle.
 */
photo_region region_about(const float middle_px[2], const float top_px[2]);
#endif
