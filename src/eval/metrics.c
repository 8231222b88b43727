/* PSNR and SSIM, and the rectangle they are taken on. */
#include <math.h>
#include <string.h>

#include "eval/metrics.h"

bool mask_bounds(const uint8_t *mask, int width, int height, rectangle *out) {
    int left = width, right = -1, top = height, bottom = -1;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            if (!mask[(size_t)y * (size_t)width + (size_t)x]) continue;
            if (x < left) left = x;
            if (x > right) right = x;
            if (y < top) top = y;
            if (y > bottom) bottom = y;
        }
    *out = (rectangle){0};
    if (right < 0) return false;
    *out = (rectangle){left, top, right - left + 1, bottom - top + 1};
    return true;
}

double metric_psnr(int64_t pixels, const float *prediction, const float *truth, const uint8_t *mask) {
    double sum = 0;
    int64_t count = 0;
    for (int64_t i = 0; i < pixels; i++) {
        if (!mask[i]) continue;
        for (int k = 0; k < 3; k++) {
            double d = (double)prediction[3 * i + k] - truth[3 * i + k];
            sum += d * d;
        }
        count += 3;
    }
    if (!count) return NAN;
    return -10 * log10(fmax(sum / (double)count, 1e-10));
}

void masked_crop(const float *picture, const uint8_t *mask, int width, rectangle r, float *out) {
    for (int y = 0; y < r.height; y++)
        for (int x = 0; x < r.width; x++) {
            size_t from = (size_t)(y + r.top) * (size_t)width + (size_t)(x + r.left);
            float *to = out + 3 * ((size_t)y * (size_t)r.width + (size_t)x);
            for (int k = 0; k < 3; k++) to[k] = mask[from] ? picture[3 * from + (size_t)k] : 0;
        }
}

/* Sums over all pixels above and to the left, (width + 1) x (height + 1), of one channel's a, b, aa, bb, ab.
 */
enum { MOMENTS = 5 };
typedef double moments[MOMENTS];

static void summed_area(int width, int height, int channels, const float *a, const float *b, moments *table) {
    size_t stride = (size_t)width + 1;
    memset(table, 0, stride * sizeof *table);
    for (int y = 0; y < height; y++) {
        moments row = {0};
        moments *line = table + ((size_t)y + 1) * stride;
        memset(line, 0, sizeof *line);
        for (int x = 0; x < width; x++) {
            size_t i = ((size_t)y * (size_t)width + (size_t)x) * (size_t)channels;
            double u = a[i], v = b[i];
            const moments pixel = {u, v, u * u, v * v, u * v};
            for (int m = 0; m < MOMENTS; m++) {
                row[m] += pixel[m];
                line[x + 1][m] = line[(ptrdiff_t)x + 1 - (ptrdiff_t)stride][m] + row[m];
            }
        }
    }
}

/* (2 ma mb + C1)(2 cab + C2) / ((ma^2 + mb^2 + C1)(va + vb + C2)), summed over the windows of one channel. */
static double ssim_sum(int width, int height, const moments *table, double range) {
    const int n = METRIC_SSIM_WINDOW, area = n * n;
    const double c1 = 0.01 * range * 0.01 * range, c2 = 0.03 * range * 0.03 * range;
    const double unbiased = (double)area / (area - 1);
    const size_t stride = (size_t)width + 1;
    double sum = 0;
    for (int y = 0; y + n <= height; y++)
        for (int x = 0; x + n <= width; x++) {
            const moments *top = table + (size_t)y * stride + (size_t)x, *bottom = top + (size_t)n * stride;
            moments mean;
            for (int m = 0; m < MOMENTS; m++)
                mean[m] = (bottom[n][m] - bottom[0][m] - top[n][m] + top[0][m]) / area;
            double va = unbiased * (mean[2] - mean[0] * mean[0]);
            double vb = unbiased * (mean[3] - mean[1] * mean[1]);
            double cab = unbiased * (mean[4] - mean[0] * mean[1]);
            sum += (2 * mean[0] * mean[1] + c1) * (2 * cab + c2) /
                   ((mean[0] * mean[0] + mean[1] * mean[1] + c1) * (va + vb + c2));
        }
    return sum;
}

sherf_status metric_ssim(context *c, int width, int height, int channels, const float *a, const float *b,
                         double range, double *out) {
    const int n = METRIC_SSIM_WINDOW;
    *out = NAN;
    if (width < n || height < n)
        return failure(c, SHERF_BAD_ARGUMENT, "SSIM of a %d x %d picture: at least %d x %d is needed", width,
                       height, n, n);
    moments *table = mem_alloc(c, ((size_t)width + 1) * ((size_t)height + 1), sizeof *table);
    if (!table) return SHERF_NO_MEMORY;
    double sum = 0;
    for (int k = 0; k < channels; k++) {
        summed_area(width, height, channels, a + k, b + k, table);
        sum += ssim_sum(width, height, table, range);
    }
    *out = sum / ((double)channels * (width - n + 1) * (height - n + 1));
    mem_free(table);
    return SHERF_OK;
}
