/* OpenCV's resize: INTER_AREA for shrinking, INTER_LINEAR for growing, INTER_NEAREST for masks. Sums run in
 * OpenCV's order, so the floats are the same. */
#include <float.h>
#include <math.h>
#include <string.h>

#include "data/data.h"

static sherf_status resize_check(context *c, int width, int height) {
    if (width >= 1 && height >= 1 && width <= IMAGE_SIDE_MAX && height <= IMAGE_SIDE_MAX) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "a picture cannot be resized to %d x %d", width, height);
}

/* One contribution from source pixel `from` to target pixel `to`. */
typedef struct {
    int to, from;
    float weight;
} area_share;

/* The shares of every target pixel in order; at most 2 * source + target of them. */
static int area_shares(int source, int target, area_share *share) {
    double scale = 1 / ((double)target / source);
    int n = 0;
    for (int to = 0; to < target; to++) {
        double begin = to * scale, end = begin + scale;
        double cell = fmin(scale, source - begin);
        int first = (int)ceil(begin), last = (int)floor(end);
        if (last > source - 1) last = source - 1;
        if (first > last) first = last;
        if (first - begin > 1e-3) share[n++] = (area_share){to, first - 1, (float)((first - begin) / cell)};
        for (int x = first; x < last; x++) share[n++] = (area_share){to, x, (float)(1 / cell)};
        if (end - last > 1e-3)
            share[n++] = (area_share){to, last, (float)(fmin(fmin(end - last, 1), cell) / cell)};
    }
    return n;
}

static sherf_status area_general(context *c, const sherf_image *source, sherf_image *target) {
    sherf_status status = SHERF_NO_MEMORY;
    int channels = source->channels;
    size_t row_values = (size_t)target->width * channels;
    area_share *across = mem_alloc(c, (size_t)2 * source->width + target->width, sizeof *across);
    area_share *down = mem_alloc(c, (size_t)2 * source->height + target->height, sizeof *down);
    float *row = mem_alloc(c, row_values, sizeof *row);
    if (!across || !down || !row) goto done;
    int n = area_shares(source->width, target->width, across);
    int count = area_shares(source->height, target->height, down);
    int previous = -1;
    for (int j = 0; j < count; j++) {
        const float *in = source->data + (size_t)down[j].from * source->width * channels;
        float *out = target->data + (size_t)down[j].to * row_values;
        memset(row, 0, row_values * sizeof *row);
        for (int k = 0; k < n; k++)
            for (int ch = 0; ch < channels; ch++)
                row[across[k].to * channels + ch] += in[across[k].from * channels + ch] * across[k].weight;
        float weight = down[j].weight;
        if (down[j].to != previous)
            for (size_t x = 0; x < row_values; x++) out[x] = weight * row[x];
        else
            for (size_t x = 0; x < row_values; x++) out[x] += weight * row[x];
        previous = down[j].to;
    }
    status = SHERF_OK;
done:
    mem_free(across);
    mem_free(down);
    mem_free(row);
    return status;
}

/* An integer number of source pixels for each target pixel: plain means, summed four at a time. */
static void area_whole(const sherf_image *source, sherf_image *target, int step_x, int step_y) {
    int channels = source->channels, area = step_x * step_y;
    float scale = 1.f / area;
    for (int y = 0; y < target->height; y++)
        for (int x = 0; x < target->width; x++)
            for (int ch = 0; ch < channels; ch++) {
                const float *in = source->data +
                                  (((size_t)y * step_y) * source->width + (size_t)x * step_x) * channels + ch;
                float sum = 0, four = 0;
                for (int k = 0; k < area; k++) {
                    float v = in[((size_t)(k / step_x) * source->width + k % step_x) * channels];
                    if (k >= area / 4 * 4) {
                        sum += v;
                        continue;
                    }
                    four = k % 4 ? four + v : v;
                    if (k % 4 == 3) sum += four;
                }
                target->data[((size_t)y * target->width + x) * channels + ch] = sum * scale;
            }
}

/* Position of target pixel `to` between source pixels *from and *from + 1 (equal at the borders). */
static float linear_share(int to, double scale, int source, int *from, int *next) {
    float f = (float)((to + 0.5) * scale - 0.5);
    int at = (int)floorf(f);
    f -= at;
    if (at < 0) at = 0, f = 0;
    if (at >= source - 1) at = source - 1, f = 0;
    *from = at;
    *next = at + 1 < source ? at + 1 : at;
    return f;
}

static void linear(const sherf_image *source, sherf_image *target) {
    int channels = source->channels;
    double scale_x = 1 / ((double)target->width / source->width);
    double scale_y = 1 / ((double)target->height / source->height);
    for (int y = 0; y < target->height; y++) {
        int y0, y1;
        float fy = linear_share(y, scale_y, source->height, &y0, &y1);
        const float *in0 = source->data + (size_t)y0 * source->width * channels;
        const float *in1 = source->data + (size_t)y1 * source->width * channels;
        for (int x = 0; x < target->width; x++) {
            int x0, x1;
            float fx = linear_share(x, scale_x, source->width, &x0, &x1);
            for (int ch = 0; ch < channels; ch++) {
                float a = in0[x0 * channels + ch] * (1 - fx) + in0[x1 * channels + ch] * fx;
                float b = in1[x0 * channels + ch] * (1 - fx) + in1[x1 * channels + ch] * fx;
                target->data[((size_t)y * target->width + x) * channels + ch] = a * (1 - fy) + b * fy;
            }
        }
    }
}

sherf_status image_resize_area(context *c, sherf_image *image, int width, int height) {
    sherf_status status = resize_check(c, width, height);
    if (status) return status;
    if (width == image->width && height == image->height) return SHERF_OK;
    sherf_image target = {width, height, image->channels, NULL};
    target.data = mem_alloc(c, (size_t)width * height, image->channels * sizeof *target.data);
    if (!target.data) return SHERF_NO_MEMORY;
    double scale_x = 1 / ((double)width / image->width), scale_y = 1 / ((double)height / image->height);
    long step_x = lrint(scale_x), step_y = lrint(scale_y);
    bool whole = fabs(scale_x - step_x) < DBL_EPSILON && fabs(scale_y - step_y) < DBL_EPSILON &&
                 step_x * width <= image->width && step_y * height <= image->height;
    if (scale_x < 1 || scale_y < 1)
        linear(image, &target);
    else if (whole)
        area_whole(image, &target, (int)step_x, (int)step_y);
    else
        status = area_general(c, image, &target);
    if (status) {
        mem_free(target.data);
        return status;
    }
    mem_free(image->data);
    *image = target;
    return SHERF_OK;
}

sherf_status image_resize_nearest(context *c, image_u8 *image, int width, int height) {
    sherf_status status = resize_check(c, width, height);
    if (status) return status;
    if (width == image->width && height == image->height) return SHERF_OK;
    uint8_t *target = mem_alloc(c, (size_t)width * height, (size_t)image->channels);
    if (!target) return SHERF_NO_MEMORY;
    double scale_x = 1 / ((double)width / image->width), scale_y = 1 / ((double)height / image->height);
    for (int y = 0; y < height; y++) {
        int from_y = (int)floor(y * scale_y);
        if (from_y > image->height - 1) from_y = image->height - 1;
        for (int x = 0; x < width; x++) {
            int from_x = (int)floor(x * scale_x);
            if (from_x > image->width - 1) from_x = image->width - 1;
            memcpy(target + ((size_t)y * width + x) * image->channels,
                   image->data + ((size_t)from_y * image->width + from_x) * image->channels,
                   (size_t)image->channels);
        }
    }
    mem_free(image->data);
    *image = (image_u8){width, height, image->channels, target};
    return SHERF_OK;
}
