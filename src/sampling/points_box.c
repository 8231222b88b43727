/* All samples of the rays at the box, and where points of rays are in the world. */
#include "sampling/sampling.h"

static sherf_status fill(context *c, const ray_bundle *rays, point_set *p) {
    int64_t met = 0;
    for (int64_t n = 0; n < p->rays; n++) met += rays->at_box[n] != 0;
    if (met > INT32_MAX / 3 / p->samples)
        return failure(c, SHERF_BAD_ARGUMENT, "points: %lld rays of %d samples are too many for one frame",
                       (long long)met, p->samples);
    p->count = met * p->samples;
    p->first = mem_alloc(c, (size_t)p->rays + 1, sizeof *p->first);
    p->ray = mem_alloc(c, (size_t)p->count + 1, sizeof *p->ray);
    p->sample = mem_alloc(c, (size_t)p->count + 1, sizeof *p->sample);
    if (!p->first || !p->ray || !p->sample) return SHERF_NO_MEMORY;
    int32_t at = 0;
    for (int64_t n = 0; n < p->rays; n++) {
        p->first[n] = at;
        for (int i = 0; rays->at_box[n] && i < p->samples; i++, at++) {
            p->ray[at] = (int32_t)n;
            p->sample[at] = i;
        }
    }
    p->first[p->rays] = at;
    return SHERF_OK;
}

sherf_status points_of_box(context *c, const ray_bundle *rays, int samples, point_set **out) {
    *out = NULL;
    if (samples < 1 || samples > POINT_SAMPLES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "points: %d samples a ray, must be 1 to %d", samples,
                       POINT_SAMPLES_MAX);
    point_set *p = mem_zero(c, 1, sizeof *p);
    if (!p) return SHERF_NO_MEMORY;
    p->rays = (int64_t)rays->width * rays->height;
    p->samples = samples;
    p->on = rays;
    sherf_status status = fill(c, rays, p);
    if (status == SHERF_OK)
        *out = p;
    else
        points_free(p);
    return status;
}

float point_depth(const point_set *p, int64_t i) {
    if (p->depth) return p->depth[i];
    const float near = p->on->near[p->ray[i]], far = p->on->far[p->ray[i]];
    return near + (far - near) * ray_fraction(p->sample[i], p->samples);
}

void point_world(const point_set *p, int64_t i, float out_world[3]) {
    const float *d = p->on->direction + 3 * (int64_t)p->ray[i], t = point_depth(p, i);
    for (int k = 0; k < 3; k++) out_world[k] = p->on->origin_world[k] + t * d[k];
}
