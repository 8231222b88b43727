/* The lattice of rays on which a coarse frame evaluates the coarse field. */
#include <math.h>
#include <string.h>

#include "sampling/points_inside.h"

float points_step_m(const points_job *job, int64_t n) {
    const ray_bundle *r = job->rays;
    const float *d = r->direction + 3 * n;
    const float step = job->samples > 1 ? (r->far[n] - r->near[n]) / (float)(job->samples - 1) : 0;
    return step * sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
}

bool points_nearest(const points_job *job, int64_t n, int i, float x[3], int32_t *guess) {
    sample_smpl(job, n, i, x);
    const int32_t nearest = vertex_grid_nearest_from(job->grid, x, *guess, NULL);
    if (nearest >= 0) *guess = nearest;
    return nearest >= 0;
}

bool points_coarse_value(const points_job *job, int64_t n, int i, int32_t *guess, float value[4]) {
    float x[3];
    if (!points_nearest(job, n, i, x, guess)) return false;
    deform_to_canonical(job->body, job->target, 1, x, NULL, guess, x, NULL);
    coarse_at(job->coarse, x, value);
    return true;
}

/* The ray of the picture that is the lattice's ray m. */
static int64_t ray_of(const points_job *job, int64_t m) {
    const ray_lattice *l = &job->lattice;
    return m / l->columns * l->stride * job->rays->width + m % l->columns * l->stride;
}

/* The first and the last candidate of each ray. */
static void find_ranges(points_job *job, int64_t count) {
    ray_lattice *l = &job->lattice;
    for (int64_t m = 0; m < count; m++) {
        const uint64_t *bits = job->sample + ray_of(job, m) * job->words;
        l->low[m] = l->high[m] = 0;
        for (int w = job->words - 1; w >= 0; w--)
            if (bits[w]) l->low[m] = 64 * w + __builtin_ctzll(bits[w]);
        for (int w = 0; w < job->words; w++)
            if (bits[w]) l->high[m] = 64 * w + 64 - __builtin_clzll(bits[w]);
        l->first[m + 1] = l->first[m] + l->high[m] - l->low[m];
    }
}

static void evaluate(points_job *job, int64_t m) {
    ray_lattice *l = &job->lattice;
    const int64_t n = ray_of(job, m);
    float(*value)[4] = l->value + l->first[m];
    float light = 1;
    int32_t guess = -1;
    l->end[m] = INT32_MAX;
    if (l->low[m] == l->high[m]) return;
    const float delta = points_step_m(job, n);
    memset(value, 0, (size_t)(l->high[m] - l->low[m]) * sizeof *value);
    for (int w = 0; w < job->words; w++)
        for (uint64_t bits = job->sample[n * job->words + w]; bits; bits &= bits - 1) {
            const int i = 64 * w + __builtin_ctzll(bits);
            float *v = value[i - l->low[m]];
            if (!points_coarse_value(job, n, i, &guess, v) || !(v[0] > 0)) continue;
            light *= expf(-v[0] * delta);
            if (light > COARSE_HIDDEN) continue;
            l->end[m] = i + 1;
            return;
        }
}

/* Rays of the lattice are at most this part of a cell apart. */
static int stride_of(const points_job *job) {
    const float part = 0.75f, pitch = job->pitch_m * job->coarse->per_m;
    const int stride = pitch > 0 ? (int)fminf(part / pitch, 8) : 1;
    return stride > 1 ? stride : 1;
}

sherf_status ray_lattice_create(context *c, points_job *job) {
    ray_lattice *l = &job->lattice;
    *l = (ray_lattice){.stride = stride_of(job)};
    if (l->stride == 1) return SHERF_OK;
    l->columns = (job->rays->width - 1) / l->stride + 1;
    l->rows = (job->rays->height - 1) / l->stride + 1;
    const size_t count = (size_t)l->columns * (size_t)l->rows;
    l->low = mem_alloc(c, count, sizeof *l->low);
    l->high = mem_alloc(c, count, sizeof *l->high);
    l->end = mem_alloc(c, count, sizeof *l->end);
    l->first = mem_zero(c, count + 1, sizeof *l->first);
    if (!l->low || !l->high || !l->end || !l->first) return SHERF_NO_MEMORY;
    find_ranges(job, (int64_t)count);
    l->value = mem_alloc(c, (size_t)l->first[count] + 1, sizeof *l->value);
    if (!l->value) return SHERF_NO_MEMORY;
#pragma omp parallel for schedule(dynamic, 64) num_threads(c->threads)
    for (size_t m = 0; m < count; m++) evaluate(job, (int64_t)m);
    return SHERF_OK;
}

/* Returns the number of the ray in the picture. */
static int64_t add_lattice_ray(const points_job *job, int row, int column, float weight, ray_surrounding *s) {
    const ray_lattice *l = &job->lattice;
    const int64_t m = (int64_t)row * l->columns + column;
    s->weight[s->count] = weight;
    s->ray[s->count].at = l->first[m] - l->low[m];
    s->ray[s->count].low = l->low[m];
    s->ray[s->count].high = l->high[m];
    s->ray[s->count++].end = l->end[m];
    return ray_of(job, m);
}

bool ray_lattice_surround(const points_job *job, int64_t n, float step_m, ray_surrounding *s) {
    const float same_m = 0.002f, opaque = 2, differ = 0.2f; /* the last two in optical depth */
    const ray_lattice *l = &job->lattice;
    const ray_bundle *r = job->rays;
    if (l->stride == 1) return false;
    const int row = (int)(n / r->width), column = (int)(n % r->width);
    const int low_row = row / l->stride, low_column = column / l->stride;
    const float part[2] = {(float)(row - low_row * l->stride) / (float)l->stride,
                           (float)(column - low_column * l->stride) / (float)l->stride};
    float near = -r->near[n], far = -r->far[n];
    *s = (ray_surrounding){.differ = differ / step_m, .opaque = opaque / step_m};
    if ((part[0] > 0 && low_row + 1 >= l->rows) || (part[1] > 0 && low_column + 1 >= l->columns))
        return false;
    for (int k = 0; k < 4; k++) {
        const float weight = (k / 2 ? part[0] : 1 - part[0]) * (k % 2 ? part[1] : 1 - part[1]);
        if (!(weight > 0)) continue;
        const int64_t other = add_lattice_ray(job, low_row + k / 2, low_column + k % 2, weight, s);
        if (!r->at_box[other]) return false;
        near += weight * r->near[other];
        far += weight * r->far[other];
    }
    return fabsf(near) < same_m && fabsf(far) < same_m;
}

bool ray_lattice_value(const ray_lattice *l, const ray_surrounding *s, int i, float value[4]) {
    typedef float four __attribute__((vector_size(16), may_alias));
    four sum = {0};
    float lowest = s->opaque, highest = 0;
    for (int k = 0; k < s->count; k++) {
        if (i >= s->ray[k].end) return false;
        float sigma = 0;
        if (i >= s->ray[k].low && i < s->ray[k].high) {
            const four own = *(const four *)l->value[s->ray[k].at + i];
            sum += s->weight[k] * own;
            sigma = own[0] > 0 ? own[0] : 0;
        }
        lowest = sigma < lowest ? sigma : lowest;
        highest = sigma > highest ? sigma : highest;
    }
    *(four *)value = sum;
    return (highest < s->opaque ? highest : s->opaque) - lowest <= s->differ;
}

void ray_lattice_free(ray_lattice *l) {
    mem_free(l->low);
    mem_free(l->high);
    mem_free(l->end);
    mem_free(l->first);
    mem_free(l->value);
    *l = (ray_lattice){0};
}
