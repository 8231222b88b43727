/* shrink: pictures made smaller by the mean over each pixel's area, without ever being whole as floats. */
#ifndef SHERF_ESTIMATE_SHRINK_H
#define SHERF_ESTIMATE_SHRINK_H

#include "base/base.h"

/* Row y of the source into row [width, channels]. Called from several threads at once. */
typedef void (*shrink_row)(const void *user, int y, float *row);

/* The source of width x height pixels as out->width x out->height (neither larger), out->channels: takes
 * out->data. The same bits for any number of threads. */
sherf_status picture_shrink(context *c, shrink_row read, const void *user, int width, int height,
                            sherf_image *out);
#endif
