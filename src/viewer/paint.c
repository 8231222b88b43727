/* Turns a frame into a picture: colour, opacity, depth, or normals computed from the depth. */
#include <math.h>
#include <string.h>

#include "io/image.h"
#include "viewer/viewer.h"

/* Near 1, far 0.2. */
static float depth_grey(const viewer_optics *o, float depth_m) {
    float range = o->far_m - o->near_m, v = range > 0 ? 1 - 0.8f * (depth_m - o->near_m) / range : 1;
    return v < 0.2f ? 0.2f : v > 1 ? 1 : v;
}

/* ---- normals ----
 * A pixel's depth is a mean along its ray: smooth but for some noise. It is first averaged over its
 * neighbours, weighted by their opacity, without those a hand's breadth in front or behind. */
static const float edge_m = 0.04f;

static void smooth_line(const float *depth, const float *weight, int count, size_t stride, int radius,
                        float *out) {
    for (int i = 0; i < count; i++) {
        size_t at = (size_t)i * stride;
        float sum = 0, weights = 0;
        out[at] = depth[at];
        if (weight[at] < 0.3f) continue;
        for (int k = -radius; k <= radius; k++) {
            int j = i + k;
            if (j < 0 || j >= count) continue;
            size_t from = (size_t)j * stride;
            if (weight[from] < 0.3f || fabsf(depth[from] - depth[at]) > edge_m) continue;
            float w = weight[from] * (float)(radius + 1 - (k < 0 ? -k : k));
            sum += w * depth[from];
            weights += w;
        }
        if (weights > 0) out[at] = sum / weights;
    }
}

/* Filters twice along rows and twice along columns; the result is in scratch. */
static void smooth(const viewer_request *r, const float *depth, const float *opacity, float *scratch) {
    int width = r->width, height = r->height;
    size_t pixels = (size_t)width * (size_t)height;
    int radius = (int)((float)height / 220 * (r->zoom > 1 ? sqrtf(r->zoom) : 1)) + 1;
    if (radius > 8) radius = 8;
    float *a = scratch, *b = scratch + pixels;
    const float *from = depth;
    for (int round = 0; round < 2; round++) {
        for (int y = 0; y < height; y++) {
            size_t row = (size_t)y * (size_t)width;
            smooth_line(from + row, opacity + row, width, 1, radius, b + row);
        }
        for (int x = 0; x < width; x++) smooth_line(b + x, opacity + x, height, (size_t)width, radius, a + x);
        from = a;
    }
}

/* The difference between a point's two neighbours along an axis; one may be missing. */
static bool slope(const viewer_request *r, const viewer_optics *o, const float *depth, const float *opacity,
                  int x, int y, int dx, int dy, float out[3]) {
    float p[2][3];
    int steps = 0;
    for (int side = 0; side < 2; side++) {
        int s = side ? 1 : -1, u = x + s * dx, v = y + s * dy;
        size_t here = (size_t)y * (size_t)r->width + (size_t)x;
        bool in = u >= 0 && u < r->width && v >= 0 && v < r->height;
        size_t at = in ? (size_t)v * (size_t)r->width + (size_t)u : here;
        if (!in || opacity[at] < 0.3f || fabsf(depth[at] - depth[here]) > edge_m) at = here, u = x, v = y;
        steps += at != here;
        p[side][0] = ((float)u - o->centre_px[0]) / o->focal_px * depth[at];
        p[side][1] = ((float)v - o->centre_px[1]) / o->focal_px * depth[at];
        p[side][2] = depth[at];
    }
    for (int k = 0; k < 3; k++) out[k] = p[1][k] - p[0][k];
    return steps > 0;
}

/* Colours as in tangent-space normal maps: x right, y up, z towards the camera, each from [-1, 1] to [0, 1].
 */
static void normal_color(const viewer_request *r, const viewer_optics *o, const float *depth,
                         const float *opacity, int x, int y, float rgb[3]) {
    float a[3], b[3], n[3] = {0, 0, -1};
    if (slope(r, o, depth, opacity, x, y, 1, 0, a) && slope(r, o, depth, opacity, x, y, 0, 1, b)) {
        for (int k = 0; k < 3; k++) {
            int i = (k + 1) % 3, j = (k + 2) % 3;
            n[k] = a[j] * b[i] - a[i] * b[j]; /* towards the camera: -z */
        }
        float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        for (int k = 0; k < 3; k++) n[k] = length > 0 ? n[k] / length : k == 2 ? -1 : 0;
    }
    rgb[0] = 0.5f + 0.5f * n[0];
    rgb[1] = 0.5f - 0.5f * n[1];
    rgb[2] = 0.5f - 0.5f * n[2];
}

void paint(const viewer_request *r, const viewer_optics *o, const float *color, const float *opacity,
           const float *depth, int channels, float *scratch, uint8_t *out) {
    if (r->mode == VIEWER_NORMAL) smooth(r, depth, opacity, scratch);
    for (int y = 0; y < r->height; y++)
        for (int x = 0; x < r->width; x++) {
            size_t i = (size_t)y * (size_t)r->width + (size_t)x;
            float a = opacity[i] < 0 ? 0 : opacity[i] > 1 ? 1 : opacity[i];
            float rgb[3] = {0, 0, 0}; /* multiplied by a, as color is */
            switch (r->mode) {
            case VIEWER_COLOR:
                memcpy(rgb, color + 3 * i, sizeof rgb);
                break;
            case VIEWER_OPACITY:
                rgb[0] = rgb[1] = rgb[2] = a;
                break;
            case VIEWER_DEPTH:
                rgb[0] = rgb[1] = rgb[2] = a > 0 ? a * depth_grey(o, depth[i]) : 0;
                break;
            case VIEWER_NORMAL:
                if (a > 0) normal_color(r, o, scratch, opacity, x, y, rgb);
                for (int k = 0; k < 3; k++) rgb[k] *= a;
                break;
            }
            uint8_t *to = out + i * (size_t)channels;
            bool plain = r->mode == VIEWER_OPACITY; /* grey on black, for any background */
            for (int k = 0; k < 3; k++) {
                float v = channels == 4 ? (a > 1e-4f ? rgb[k] / a : 0)
                                        : rgb[k] + (plain ? 0 : (1 - a) * r->background[k]);
                to[k] = float_to_u8(v);
            }
            if (channels == 4) to[3] = float_to_u8(a);
        }
}
