/* OpenCV's undistort: the map of initUndistortRectifyMap in 1/32 pixels, then a bilinear remap with border 0.
 * Bytes use 15-bit weights as remap does (all weights are multiples of 1/1024, so the integer arithmetic is
 * exact except for the last rounding); floats use the same weights as floats. */
#include <math.h>
#include <string.h>

#include "data/data.h"

enum { MAP_BITS = 5, MAP_STEPS = 1 << MAP_BITS, STRIPE_PIXELS = 1 << 12 };

typedef struct {
    int width, height, channels;
    const double *K, *D;
    const uint8_t *source_u8; /* one of the two pairs is set */
    uint8_t *target_u8;
    const float *source_f32;
    float *target_f32;
    bool tilted;
    double tilt[9];
    int stripe; /* rows whose map is computed with one inverse, as OpenCV does it */
} undistort_job;

/* The sensor's tilt about x and y (tx, ty; radians): projects its plane back onto the upright one. */
static void tilt_of(double tx, double ty, double out[9]) {
    const double cx = cos(tx), sx = sin(tx), cy = cos(ty), sy = sin(ty);
    const double turn[9] = {cy, sy * sx, -sy * cx, 0, cx, sx, sy, -cy * sx, cy * cx}; /* about x, then y */
    for (int i = 0; i < 3; i++) {
        out[i] = turn[8] * turn[i] - turn[2] * turn[6 + i];
        out[3 + i] = turn[8] * turn[3 + i] - turn[5] * turn[6 + i];
        out[6 + i] = turn[6 + i];
    }
}

static void tilt(const double m[9], double *x, double *y) {
    const double u = m[0] * *x + m[1] * *y + m[2], v = m[3] * *x + m[4] * *y + m[5];
    const double w = m[6] * *x + m[7] * *y + m[8], scale = w != 0 ? 1 / w : 1;
    *x = u * scale;
    *y = v * scale;
}

/* The position of the undistorted pixel (x, y) in the distorted picture, in 1/32 pixels. `inverse` is that of
 * K with its centre moved up by the stripe's first row. */
static void distorted_position(const undistort_job *job, const double inverse[9], int x, int y, int *u32,
                               int *v32) {
    const double *K = job->K, *D = job->D;
    double w = 1 / (y * inverse[7] + inverse[8] + x * inverse[6]);
    double px = (y * inverse[1] + inverse[2] + x * inverse[0]) * w;
    double py = (y * inverse[4] + inverse[5] + x * inverse[3]) * w;
    double x2 = px * px, y2 = py * py, r2 = x2 + y2, xy2 = 2 * px * py;
    double radial = (1 + ((D[4] * r2 + D[1]) * r2 + D[0]) * r2) / (1 + ((D[7] * r2 + D[6]) * r2 + D[5]) * r2);
    double xd = px * radial + D[2] * xy2 + D[3] * (r2 + 2 * x2) + D[8] * r2 + D[9] * r2 * r2;
    double yd = py * radial + D[2] * (r2 + 2 * y2) + D[3] * xy2 + D[10] * r2 + D[11] * r2 * r2;
    if (job->tilted) tilt(job->tilt, &xd, &yd);
    double u = K[0] * xd + K[2], v = K[4] * yd + K[5];
    /* Far outside is outside: OpenCV wraps shorts there, which no real lens reaches. NaN goes there too. */
    double limit = 1 << 20;
    if (!(fabs(u) < limit) || !(fabs(v) < limit)) u = v = -limit;
    *u32 = (int)lrint(u * MAP_STEPS);
    *v32 = (int)lrint(v * MAP_STEPS);
}

static void inverse_of(const double m[9], double out[9]) {
    double d = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6]) +
               m[2] * (m[3] * m[7] - m[4] * m[6]);
    d = 1 / d;
    out[0] = (m[4] * m[8] - m[5] * m[7]) * d;
    out[1] = (m[2] * m[7] - m[1] * m[8]) * d;
    out[2] = (m[1] * m[5] - m[2] * m[4]) * d;
    out[3] = (m[5] * m[6] - m[3] * m[8]) * d;
    out[4] = (m[0] * m[8] - m[2] * m[6]) * d;
    out[5] = (m[2] * m[3] - m[0] * m[5]) * d;
    out[6] = (m[3] * m[7] - m[4] * m[6]) * d;
    out[7] = (m[1] * m[6] - m[0] * m[7]) * d;
    out[8] = (m[0] * m[4] - m[1] * m[3]) * d;
}

static void undistort_pixel(const undistort_job *job, int x, int y, int u32, int v32) {
    int channels = job->channels, width = job->width, height = job->height;
    int x0 = u32 >> MAP_BITS, y0 = v32 >> MAP_BITS;
    int fx = u32 & (MAP_STEPS - 1), fy = v32 & (MAP_STEPS - 1);
    int weight[4] = {(MAP_STEPS - fx) * (MAP_STEPS - fy), fx * (MAP_STEPS - fy), (MAP_STEPS - fx) * fy,
                     fx * fy};
    int64_t at[4];
    for (int k = 0; k < 4; k++) {
        int sx = x0 + (k & 1), sy = y0 + (k >> 1);
        bool inside = sx >= 0 && sx < width && sy >= 0 && sy < height;
        at[k] = inside ? ((int64_t)sy * width + sx) * channels : -1;
    }
    int64_t to = ((int64_t)y * width + x) * channels;
    for (int ch = 0; ch < channels; ch++) {
        if (job->source_u8) {
            int sum = 0;
            for (int k = 0; k < 4; k++)
                if (at[k] >= 0) sum += weight[k] * job->source_u8[at[k] + ch];
            job->target_u8[to + ch] = (uint8_t)((sum + 512) >> 10);
        } else {
            float part[4];
            for (int k = 0; k < 4; k++)
                part[k] = at[k] < 0 ? 0 : job->source_f32[at[k] + ch] * ((float)weight[k] / 1024);
            job->target_f32[to + ch] = part[0] + part[1] + part[2] + part[3];
        }
    }
}

static void undistort_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const undistort_job *job = arg;
    double inverse[9] = {0};
    int64_t inverse_of_stripe = -1;
    for (int64_t y = begin; y < end; y++) {
        int64_t stripe = y / job->stripe;
        if (stripe != inverse_of_stripe) {
            double moved[9];
            memcpy(moved, job->K, sizeof moved);
            moved[5] -= (double)(stripe * job->stripe);
            inverse_of(moved, inverse);
            inverse_of_stripe = stripe;
        }
        for (int x = 0; x < job->width; x++) {
            int u32, v32;
            distorted_position(job, inverse, x, (int)(y - stripe * job->stripe), &u32, &v32);
            undistort_pixel(job, x, (int)y, u32, v32);
        }
    }
}

/* OpenCV's distortion model has no skew and no projective row, so only the focal lengths and centre are used;
 * without distortion the map is the identity, and so is the remap. */
static bool undistort_needed(const double D[DISTORTION_MAX]) {
    for (int i = 0; i < DISTORTION_MAX; i++)
        if (D[i] != 0) return true;
    return false;
}

static void undistort_run(const context *c, undistort_job *job) {
    int stripe = STRIPE_PIXELS / (job->width > 0 ? job->width : 1);
    job->stripe = stripe < 1 ? 1 : stripe > job->height ? job->height : stripe;
    if (job->stripe < 1) return;
    parallel_for(c, job->height, 16, undistort_rows, job);
}

/* *data, whose values take `size` bytes, becomes a new picture. */
static sherf_status undistort(context *c, undistort_job job, size_t size, void **data) {
    if (!undistort_needed(job.D)) return SHERF_OK;
    job.tilted = job.D[12] != 0 || job.D[13] != 0;
    tilt_of(job.D[12], job.D[13], job.tilt);
    void *target = mem_alloc(c, (size_t)job.width * (size_t)job.height, (size_t)job.channels * size);
    if (!target) return SHERF_NO_MEMORY;
    if (size == 1)
        job.source_u8 = *data, job.target_u8 = target;
    else
        job.source_f32 = *data, job.target_f32 = target;
    undistort_run(c, &job);
    mem_free(*data);
    *data = target;
    return SHERF_OK;
}

sherf_status image_undistort(context *c, image_u8 *image, const double K[9], const double D[DISTORTION_MAX]) {
    void *data = image->data;
    sherf_status status =
        undistort(c, (undistort_job){image->width, image->height, image->channels, K, D}, 1, &data);
    image->data = data;
    return status;
}

sherf_status image_undistort_f32(context *c, sherf_image *image, const double K[9],
                                 const double D[DISTORTION_MAX]) {
    void *data = image->data;
    sherf_status status = undistort(c, (undistort_job){image->width, image->height, image->channels, K, D},
                                    sizeof(float), &data);
    image->data = data;
    return status;
}
