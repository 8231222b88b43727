/* Smooths the depths of hazy surfaces, which flicker from pixel to pixel, and everything that depends on
 * them. It smooths along the surface, not across its edges. */
#include <math.h>
#include <string.h>

#include "avatar/detail.h"
#include "scene/ray.h"

/* Neighbours that differ more in depth have no weight. */
static const float edge_m = 0.05f, faint = 0.3f;
enum { ROUNDS = 2 };
static const float jump_m[2] = {0.03f, 0.07f}, opaque[2] = {0.5f, 0.9f};

void detail_optics_of(const sherf_camera *camera, detail_optics *out) {
    ray_optics o;
    ray_optics_of(camera, &o);
    memcpy(out->origin, o.origin, sizeof out->origin);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            float sum = 0; /* R^T K^-1 */
            for (int k = 0; k < 3; k++) sum += camera->R[3 * k + i] * o.K_inverse[3 * k + j];
            out->to_world[3 * i + j] = sum;
        }
}

float detail_px_per_m(const sherf_camera *camera, const posed_body *posed) {
    float root[3], depth = camera->T_m[2];
    for (int k = 0; k < 3; k++) {
        const float *R = posed->R + 3 * k, *j = posed->joints_smpl[0];
        root[k] = R[0] * j[0] + R[1] * j[1] + R[2] * j[2] + posed->Th[k];
        depth += camera->R[6 + k] * root[k];
    }
    if (!(depth > 0.1f)) depth = 0.1f;
    return fabsf(camera->K[4]) / depth;
}

int detail_pixels(const sherf_camera *camera, const posed_body *posed, float length_m, int max) {
    const float wide = length_m * detail_px_per_m(camera, posed) + 0.5f;
    return wide < 1 ? 1 : wide < (float)max ? (int)wide : max;
}

float detail_jump(const float *depth, int width, int height, int reach, int x, int y) {
    const size_t w = (size_t)width, n = (size_t)y * w + (size_t)x, r = (size_t)reach;
    float max = 0;
    if (x >= reach) max = fmaxf(max, fabsf(depth[n] - depth[n - r]));
    if (y >= reach) max = fmaxf(max, fabsf(depth[n] - depth[n - r * w]));
    if (x + reach < width) max = fmaxf(max, fabsf(depth[n] - depth[n + r]));
    if (y + reach < height) max = fmaxf(max, fabsf(depth[n] - depth[n + r * w]));
    return max;
}

float detail_solid(float opacity, float jump) {
    return detail_rise(opacity, opaque) * (1 - detail_rise(jump, jump_m));
}

typedef struct {
    const sherf_image *opacity;
    const float *depth, *value;
    float *out;
    int radius;
    bool down; /* along columns; otherwise rows */
} smooth_job;

static void smooth_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const smooth_job *j = arg;
    const int width = j->opacity->width, height = j->opacity->height, count = j->down ? height : width;
    const float *opacity = j->opacity->data;
    const int64_t stride = j->down ? width : 1;
    for (int64_t y = begin; y < end; y++)
        for (int64_t x = 0; x < width; x++) {
            const int64_t n = y * width + x, at = j->down ? y : x;
            j->out[n] = j->value[n];
            if (opacity[n] < faint) continue;
            const int64_t first = at < j->radius ? -at : -j->radius;
            const int64_t last = at + j->radius < count ? j->radius : count - 1 - at;
            float sum = 0, weights = 0;
            for (int64_t k = first; k <= last; k++) {
                const int64_t from = n + k * stride;
                const float off = (j->depth[from] - j->depth[n]) / edge_m, near = 1 - off * off;
                if (opacity[from] < faint || !(near > 0)) continue;
                const float w = opacity[from] * near * near * (float)(j->radius + 1 - (k < 0 ? -k : k));
                sum += w * j->value[from];
                weights += w;
            }
            if (weights > 0) j->out[n] = sum / weights;
        }
}

void detail_smooth(const context *c, const sherf_image *opacity, int radius, float *depth, float *value,
                   float *room) {
    float *of = value ? value : depth;
    for (int pass = 0; pass < 2 * ROUNDS; pass += 2) {
        smooth_job job = {opacity, depth, of, room, radius, false};
        parallel_for(c, opacity->height, 8, smooth_rows, &job);
        job = (smooth_job){opacity, value ? depth : room, room, of, radius, true};
        parallel_for(c, opacity->height, 8, smooth_rows, &job);
    }
}
