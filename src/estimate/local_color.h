/* local_color: the colours that person and background have locally. */
#ifndef SHERF_ESTIMATE_LOCAL_COLOR_H
#define SHERF_ESTIMATE_LOCAL_COLOR_H

#include "base/base.h"

/* Sharpens `value`, [H, W], each pixel's probability of being the person's, by the pixel's colour in picture,
 * [H, W, 3]: by Bayes' rule with histograms of colour in cells of the picture of `cell` pixels on a side,
 * each over its neighbours too, to which pixels count by how sure they are. The same bits for any number of
 * threads. */
sherf_status local_color_sharpen(context *c, const sherf_image *picture, int cell, float *value);
#endif
