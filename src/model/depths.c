/* Random depths: stratified, and distributed by the result of a first pass. */
#include "model/depths.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* ---- stratified ---- */
typedef struct {
    const point_set *points;
    uint64_t key;
    float *depth;
} stratified_job;

static void stratified_range(void *arg, int64_t begin, int64_t end, int thread) {
    const stratified_job *j = arg;
    const point_set *p = j->points;
    for (int64_t i = begin; i < end; i++) {
        const float near = p->on->near[p->ray[i]], far = p->on->far[p->ray[i]];
        const uint64_t at = (uint64_t)p->ray[i] * (uint64_t)p->samples + (uint64_t)p->sample[i];
        const double u = j->key ? random_uniform(j->key, at) : 0.5;
        j->depth[i] = near + (far - near) * (float)((p->sample[i] + u) / p->samples);
    }
}

point_set *depths_stratified(tape *t, const point_set *points, uint64_t key) {
    point_set *out = tape_alloc(t, 1, sizeof *out);
    if (!out) return NULL;
    *out = *points;
    if (!(out->depth = tape_alloc(t, (size_t)points->count + 1, sizeof *out->depth))) return NULL;
    const uint64_t own = key ? random_key(key, "depths.stratified", 0) : 0;
    stratified_job job = {points, own, out->depth};
    parallel_for(tape_context(t), points->count, 1 << 14, stratified_range, &job);
    return out;
}

/* ---- jittered ---- */
static void jittered_range(void *arg, int64_t begin, int64_t end, int thread) {
    const stratified_job *j = arg;
    const point_set *p = j->points;
    for (int64_t i = begin; i < end; i++) {
        const float near = p->on->near[p->ray[i]], far = p->on->far[p->ray[i]];
        const uint64_t at = (uint64_t)p->ray[i] * (uint64_t)p->samples + (uint64_t)p->sample[i];
        const int last = p->samples - 1;
        const double from = p->sample[i] ? p->sample[i] - 0.5 : 0;
        const double to = p->sample[i] < last ? p->sample[i] + 0.5 : last;
        const double share = (from + (to - from) * random_uniform(j->key, at)) / (last > 0 ? last : 1);
        j->depth[i] = near + (far - near) * (float)share;
    }
}

point_set *depths_jittered(tape *t, const point_set *points, float last_way, uint64_t key) {
    point_set *out = tape_alloc(t, 1, sizeof *out);
    if (!out) return NULL;
    *out = *points;
    out->last_way = last_way;
    if (!(out->depth = tape_alloc(t, (size_t)points->count + 1, sizeof *out->depth))) return NULL;
    stratified_job job = {points, random_key(key, "depths.jittered", 0), out->depth};
    parallel_for(tape_context(t), points->count, 1 << 14, jittered_range, &job);
    return out;
}

/* ---- distributed by the result of the first pass ---- */
static const double weight_spare = 1e-5; /* so that every interval can be drawn */

typedef struct {
    const point_set *coarse;
    const float *sigma;
    fine_draw draw;
    uint64_t key[3];
    double *scratch; /* by thread: samples + 1 */
    point_set *out;
} fine_job;

static int by_depth(const void *a, const void *b) {
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static double chance(const fine_job *j, int which, int64_t ray, int i, double otherwise) {
    return j->key[which] ? random_uniform(j->key[which], (uint64_t)ray * 64 + (uint64_t)i) : otherwise;
}

/* The cumulative distribution of the intervals, from 0 to 1, into sum [samples + 1]. Returns the mean depth,
 * or far. */
static double weigh(const fine_job *j, int64_t ray, double *sum) {
    const point_set *p = j->coarse;
    const int64_t first = p->first[ray], last = p->first[ray + 1] - 1;
    const float *d = p->on->direction + 3 * ray;
    const double length = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
    double light = 1, seen = 0, depth = 0;
    sum[0] = 0;
    for (int64_t i = first; i <= last; i++) {
        const double next = i < last ? p->depth[i + 1] : p->on->far[ray];
        const double sigma = j->sigma[i] > 0 ? (double)j->sigma[i] : 0;
        const double alpha = 1 - exp(-sigma * (next - p->depth[i]) * length), w = alpha * light;
        light *= 1 - alpha + 1e-10;
        seen += w;
        depth += w * p->depth[i];
        sum[i - first + 1] = sum[i - first] + w + weight_spare;
    }
    for (int i = 1; i <= p->samples; i++) sum[i] /= sum[p->samples];
    return seen > 1e-6 ? depth / seen : p->on->far[ray];
}

static void fine_ray(const fine_job *j, int64_t ray, double *sum) {
    const point_set *p = j->coarse;
    const int S = p->samples;
    const double near = p->on->near[ray], far = p->on->far[ray];
    const float *d = p->on->direction + 3 * ray;
    const double spread =
        j->draw.spread_m / sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
    float *depth = j->out->depth + j->out->first[ray];
    const double mean = weigh(j, ray, sum);
    memcpy(depth, p->depth + p->first[ray], (size_t)S * sizeof *depth);
    depth += S;
    for (int i = 0; i < j->draw.drawn; i++) {
        const double u = chance(j, 0, ray, i, (i + 0.5) / j->draw.drawn);
        int low = 0, high = S - 1; /* sum[low] <= u < sum[low + 1] */
        while (low < high) {
            const int middle = (low + high + 1) / 2;
            if (sum[middle] <= u)
                low = middle;
            else
                high = middle - 1;
        }
        const double within = chance(j, 1, ray, i, (u - sum[low]) / (sum[low + 1] - sum[low]));
        *depth++ = (float)(near + (far - near) * (low + within) / S);
    }
    for (int i = 0; i < j->draw.around; i++) {
        const double noise = random_normal(j->key[2], (uint64_t)ray * 64 + (uint64_t)i);
        *depth++ = (float)fmin(fmax(mean + spread * noise, near), far);
    }
    const int count = S + j->draw.drawn + j->draw.around;
    qsort(depth - count, (size_t)count, sizeof *depth, by_depth);
}

static void fine_range(void *arg, int64_t begin, int64_t end, int thread) {
    const fine_job *j = arg;
    double *sum = j->scratch + (size_t)thread * ((size_t)j->coarse->samples + 1);
    for (int64_t n = begin; n < end; n++)
        if (j->coarse->first[n] < j->coarse->first[n + 1]) fine_ray(j, n, sum);
}

/* The ray and the place on it of each point of the finer set. */
static bool fine_shape(tape *t, const point_set *coarse, int samples, point_set *out) {
    const int64_t rays = coarse->rays, count = coarse->count / coarse->samples * samples;
    *out = (point_set){.count = count, .rays = rays, .samples = samples, .on = coarse->on};
    out->first = tape_alloc(t, (size_t)rays + 1, sizeof *out->first);
    out->ray = tape_alloc(t, (size_t)count + 1, sizeof *out->ray);
    out->sample = tape_alloc(t, (size_t)count + 1, sizeof *out->sample);
    out->depth = tape_alloc(t, (size_t)count + 1, sizeof *out->depth);
    if (!out->first || !out->ray || !out->sample || !out->depth) return false;
    int32_t at = 0;
    for (int64_t n = 0; n < rays; n++) {
        out->first[n] = at;
        for (int i = 0; coarse->first[n] < coarse->first[n + 1] && i < samples; i++, at++) {
            out->ray[at] = (int32_t)n;
            out->sample[at] = i;
        }
    }
    out->first[rays] = at;
    return true;
}

point_set *depths_fine(tape *t, const point_set *coarse, const tensor *sigma, fine_draw draw, uint64_t key) {
    context *c = tape_context(t);
    point_set *out = tape_alloc(t, 1, sizeof *out);
    float *seen = tape_alloc(t, (size_t)coarse->count + 1, sizeof *seen);
    double *scratch = tape_alloc(t, (size_t)c->threads * ((size_t)coarse->samples + 1), sizeof *scratch);
    const int samples = coarse->samples + draw.drawn + draw.around;
    if (!out || !seen || !scratch || !sigma || !fine_shape(t, coarse, samples, out)) return NULL;
    sherf_status status = tensor_download(c, sigma, seen);
    if (status != SHERF_OK) return tape_fail(t, status, "%s", c->message), NULL;
    fine_job job = {.coarse = coarse, .sigma = seen, .draw = draw, .scratch = scratch, .out = out};
    for (int i = 0; i < 2; i++) job.key[i] = key ? random_key(key, "depths.fine", (uint64_t)i) : 0;
    job.key[2] = random_key(key, "depths.fine", 2);
    parallel_for(c, coarse->rays, 256, fine_range, &job);
    return out;
}
