/* guided: the guided filter with a colour picture as its guide (He, Sun and Tang 2010), with weights. In
 * every window the value is fitted as a plane over colour, value = a . colour + b, by least squares; a pixel
 * takes the mean of the planes of all windows that hold it. So values follow the picture's edges, and where
 * weights are small, a pixel takes the value of nearby pixels of its colour. */
#ifndef SHERF_ESTIMATE_GUIDED_H
#define SHERF_ESTIMATE_GUIDED_H

#include "base/base.h"

/* guide: [H, W, 3]; value, weight (positive): [H, W]; planes, out: [H, W, 4], a and b at each pixel. Windows
 * have 2 radius + 1 pixels on a side, less at the borders. epsilon, a variance of colour: edges below its
 * root are smoothed. The same bits for any number of threads. */
sherf_status guided_fit(context *c, const sherf_image *guide, const float *value, const float *weight,
                        int radius, float epsilon, float *planes);

static inline float guided_value(const float plane[4], const float color[3]) {
    return plane[0] * color[0] + plane[1] * color[1] + plane[2] * color[2] + plane[3];
}
#endif
