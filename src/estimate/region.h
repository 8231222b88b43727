/* region: squares of a photo as networks take them. */
#ifndef SHERF_ESTIMATE_REGION_H
#define SHERF_ESTIMATE_REGION_H

#include "estimate/person.h"

/* out [side, side, 3] = scale * value + shift. Where the region has more pixels than that, each of out is the
 * mean of what it covers (squares of whole pixels first, then four samples between those); else bilinear.
 * Outside the photo its nearest pixel, or black. The photo has 3 channels. */
sherf_status region_sample(context *c, const sherf_image *photo, const photo_region *region, int side,
                           bool black_outside, float scale, float shift, float *out);

/* The photo in squares of step x step pixels, each their mean (those at the right and lower edge may be cut).
 * Pixel x of it is pixel step * x + (step - 1) / 2 of the photo. Freed with mem_free(out->data). */
sherf_status photo_shrink(context *c, const sherf_image *photo, int step, sherf_image *out);
/* (u, v) of the region to the photo, pixels. */
void region_place(const photo_region *region, float u, float v, float place_px[2]);
/* And back. */
void region_find(const photo_region *region, const float place_px[2], float uv[2]);
/* The square around `middle_px` that extends 1.25 times as far as `top_px`, which should be above the middle.
 */
photo_region region_about(const float middle_px[2], const float top_px[2]);
#endif
