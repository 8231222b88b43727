/* The lattice of rays on which a coarse frame evaluates the coarse field. */
#include <math.h>
#include <string.h>

#include "sampling/points_inside.h"

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
    const float delta = points_step_m(job, n);
    float light = 1;
    int32_t guess = -1;
    float(*value)[4] = l->value + l->first[m];
    memset(value, 0, (size_t)(l->high[m] - l->low[m]) * sizeof *value);
    l->end[m] = INT32_MAX;
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

static void evaluate_range(void *arg, int64_t begin, int64_t end, int thread) {
    for (int64_t m = begin; m < end; m++) evaluate(arg, m);
}

/* Rays of the lattice are at most this part of a cell apart. */
static int stride_of(const points_job *job) {
    const float part = 0.75f, pitch = rays_pitch(job->rays) * job->coarse->per_m;
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
    parallel_for(c, (int64_t)count, 64, evaluate_range, job);
    return SHERF_OK;
}

static void add_lattice_ray(const ray_lattice *l, int row, int column, float weight, ray_surrounding *s) {
    if (!(weight > 0)) return;
    s->weight[s->count] = weight;
    s->ray[s->count++] = row * l->columns + column;
}

bool ray_lattice_surround(const points_job *job, int64_t n, ray_surrounding *s) {
    const float same_m = 0.002f;
    const ray_lattice *l = &job->lattice;
    const ray_bundle *r = job->rays;
    const int row = (int)(n / r->width), column = (int)(n % r->width);
    const int low_row = row / l->stride, low_column = column / l->stride;
    const float down = (float)(row % l->stride) / (float)l->stride;
    const float right = (float)(column % l->stride) / (float)l->stride;
    s->count = 0;
    if (l->stride == 1 || (down > 0 && low_row + 1 >= l->rows) || (right > 0 && low_column + 1 >= l->columns))
        return false;
    add_lattice_ray(l, low_row, low_column, (1 - down) * (1 - right), s);
    add_lattice_ray(l, low_row, low_column + 1, (1 - down) * right, s);
    add_lattice_ray(l, low_row + 1, low_column, down * (1 - right), s);
    add_lattice_ray(l, low_row + 1, low_column + 1, down * right, s);
    float near = -r->near[n], far = -r->far[n];
    for (int k = 0; k < s->count; k++) {
        const int64_t other = ray_of(job, s->ray[k]);
        near += s->weight[k] * r->near[other];
        far += s->weight[k] * r->far[other];
        if (!r->at_box[other]) return false;
    }
    return fabsf(near) < same_m && fabsf(far) < same_m;
}

bool ray_lattice_value(const ray_lattice *l, const ray_surrounding *s, int i, float delta, float value[4]) {
    const float opaque = 2, differ = 0.2f; /* optical depths, density times delta */
    typedef float four __attribute__((vector_size(16), may_alias));
    four sum = {0};
    float lowest = opaque, highest = 0;
    for (int k = 0; k < s->count; k++) {
        const int32_t m = s->ray[k];
        if (i >= l->end[m]) return false;
        const bool kept = i >= l->low[m] && i < l->high[m];
        const four own = kept ? *(const four *)l->value[l->first[m] + i - l->low[m]] : (four){0};
        const float depth = fminf(fmaxf(own[0] * delta, 0), opaque);
        lowest = fminf(lowest, depth);
        highest = fmaxf(highest, depth);
        sum += s->weight[k] * own;
    }
    *(four *)value = sum;
    return highest - lowest <= differ;
}

void ray_lattice_free(ray_lattice *l) {
    mem_free(l->low);
    mem_free(l->high);
    mem_free(l->end);
    mem_free(l->first);
    mem_free(l->value);
    *l = (ray_lattice){0};
}
