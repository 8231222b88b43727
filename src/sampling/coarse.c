/* Frames with a coarse field: queried samples correct the samples between them. */
#include <math.h>
#include <string.h>

#include "sampling/coarse.h"

typedef struct {
    const ray_bundle *rays;
    coarse_points *p;
    const float *rgb, *sigma; /* the model's */
    float (*moved)[4]; /* for queried samples: the model's density and colour minus the coarse field's */
} answer_job;

/* A ray's samples, from the front. */
typedef struct {
    int32_t at, end;
} ray_cursor;

/* Adds the sample's correction, if this ray has the sample and it was queried; returns the weight used. */
static float add_moved(const answer_job *j, ray_cursor *ray, int32_t sample, float weight, float sum[4]) {
    const coarse_points *p = j->p;
    while (ray->at < ray->end && p->all.sample[ray->at] < sample) ray->at++;
    if (ray->at == ray->end || p->all.sample[ray->at] != sample || p->queried_at[ray->at] < 0) return 0;
    const float *moved = j->moved[p->queried_at[ray->at]];
    for (int k = 0; k < 4; k++) sum[k] += weight * moved[k];
    return weight;
}

/* The weight of a sample before or behind relative to one beside: the square root of the ratio of their
 * distances (measured; a smaller weight would lose variation along the ray, a larger one variation across
 * it). */
static float behind_weight(const ray_bundle *r, int samples, int64_t n) {
    const int64_t other = n % r->width + 1 < r->width ? n + 1 : n - 1;
    const float *d = r->direction + 3 * n, *e = r->direction + 3 * other;
    const float step = (r->far[n] - r->near[n]) / (float)(samples > 1 ? samples - 1 : 1);
    float beside = 0, behind = 0;
    for (int k = 0; k < 3; k++) {
        beside += (d[k] - e[k]) * (d[k] - e[k]) * r->near[n] * r->near[n];
        behind += d[k] * d[k] * step * step;
    }
    return fminf(sqrtf(sqrtf(beside / fmaxf(behind, 1e-12f))), 1);
}

static void move_ray(const answer_job *j, int64_t n) {
    enum { AROUND = 4 };
    const coarse_points *p = j->p;
    const int32_t *first = p->all.first;
    const int64_t width = j->rays->width, column = n % width, row = n / width;
    const int64_t other[AROUND] = {column > 0 ? n - 1 : -1, column + 1 < width ? n + 1 : -1,
                                   row > 0 ? n - width : -1, row + 1 < j->rays->height ? n + width : -1};
    const float behind = j->rays->width > 1 ? behind_weight(j->rays, p->all.samples, n) : 1;
    ray_cursor around[AROUND];
    for (int k = 0; k < AROUND; k++)
        around[k] = other[k] < 0 ? (ray_cursor){0, 0} : (ray_cursor){first[other[k]], first[other[k] + 1]};
    for (int32_t i = first[n]; i < first[n + 1]; i++) {
        if (p->queried_at[i] != COARSE_MOVED) continue;
        const int32_t sample = p->all.sample[i];
        float sum[4] = {0}, weights = 0;
        for (int k = 0; k < AROUND; k++) weights += add_moved(j, &around[k], sample, 1, sum);
        if (i > first[n]) weights += add_moved(j, &(ray_cursor){i - 1, i}, sample - 1, behind, sum);
        if (i + 1 < first[n + 1])
            weights += add_moved(j, &(ray_cursor){i + 1, i + 2}, sample + 1, behind, sum);
        if (!(weights > 0)) continue;
        p->sigma[i] += sum[0] / weights;
        for (int k = 0; k < 3; k++) p->rgb[3 * i + k] += sum[k + 1] / weights;
    }
}

static void move_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const answer_job *j = arg;
    for (int64_t n = begin * j->rays->width; n < end * j->rays->width; n++)
        if (j->p->all.first[n] < j->p->all.first[n + 1]) move_ray(j, n);
}

/* Takes the queried samples' results; no two samples share one. */
static void take_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const answer_job *j = arg;
    coarse_points *p = j->p;
    const int64_t width = j->rays->width;
    for (int32_t i = p->all.first[begin * width]; i < p->all.first[end * width]; i++) {
        const int32_t at = p->queried_at[i];
        if (at < 0) continue;
        j->moved[at][0] = j->sigma[at] - p->sigma[i];
        for (int k = 0; k < 3; k++) j->moved[at][k + 1] = j->rgb[3 * at + k] - p->rgb[3 * i + k];
        p->sigma[i] = j->sigma[at];
        memcpy(p->rgb + 3 * (size_t)i, j->rgb + 3 * (size_t)at, 3 * sizeof *j->rgb);
    }
}

sherf_status coarse_points_answer(context *c, const ray_bundle *rays, const float *rgb, const float *sigma,
                                  coarse_points *p) {
    answer_job job = {.rays = rays, .p = p, .rgb = rgb, .sigma = sigma};
    job.moved = mem_alloc(c, (size_t)p->queried->count + 1, sizeof *job.moved);
    if (!job.moved) return SHERF_NO_MEMORY;
    parallel_for(c, rays->height, 8, take_rows, &job);
    parallel_for(c, rays->height, 8, move_rows, &job);
    mem_free(job.moved);
    return SHERF_OK;
}

void coarse_points_free(coarse_points *p) {
    points_free(p->queried);
    mem_free(p->all.first);
    mem_free(p->all.sample);
    mem_free(p->rgb);
    mem_free(p->sigma);
    mem_free(p->queried_at);
    *p = (coarse_points){0};
}
