/* mask_clean: islands and holes. */
#ifndef SHERF_ESTIMATE_MASK_CLEAN_H
#define SHERF_ESTIMATE_MASK_CLEAN_H

#include "base/base.h"

/* value, prior: [height, width], the mask and the network's result; mask_px: pixels here per pixel of the
 * network's mask. Removes pieces (values from 0.5) far smaller than the largest, and soft pixels far from the
 * others. Fills holes that are small or that the network did not see. */
sherf_status mask_clean(context *c, int width, int height, const float *prior, float mask_px, float *value);
#endif
