/* metrics: PSNR and SSIM as the paper's tables use them. Pictures are H x W x 3 float32. */
#ifndef SHERF_METRICS_H
#define SHERF_METRICS_H

#include "base/base.h"

typedef struct {
    int left, top, width, height;
} rectangle;
/* The bounding rectangle of the non-zero pixels; false when there are none. */
bool mask_bounds(const uint8_t *mask, int width, int height, rectangle *out);

/* -10 log10(mean square difference) over the pixels of the mask and 3 channels. At most 100 (equal pictures);
 * NaN when the mask is empty. */
double metric_psnr(int64_t pixels, const float *prediction, const float *truth, const uint8_t *mask);

/* Mean SSIM of two pictures of width x height x channels: every 7 x 7 window inside, unweighted, sample (n -
 * 1) covariances, k1 .01, k2 .03. scikit-image 0.19 computes the same for float pictures, where the range is
 * that of the type, 2. Needs both sides >= 7. */
enum { METRIC_SSIM_WINDOW = 7 };
static const double metric_ssim_range = 2;
sherf_status metric_ssim(context *c, int width, int height, int channels, const float *a, const float *b,
                         double range, double *out);

/* The rectangle of a picture with everything outside the mask black: rectangle.height x .width x 3. */
void masked_crop(const float *picture, const uint8_t *mask, int width, rectangle r, float *out);

#endif
