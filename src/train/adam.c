#include <math.h>

#include "tensor/cpu/variants.h"
#include "train/adam.h"

enum { GRAIN = 1 << 14 };

sherf_status adam_create(context *c, int64_t n, adam *out) {
    *out = (adam){.n = n, .second = mem_zero(c, (size_t)n, sizeof(float))};
    return out->second ? SHERF_OK : SHERF_NO_MEMORY;
}

void adam_free(adam *a) {
    mem_free(a->second);
    *a = (adam){0};
}

typedef struct {
    float *values, *second;
    const float *gradients;
    float beta2, rate, correction, eps;
} adam_job;

static VARIANT_BODY void adam_range(void *arg, int64_t begin, int64_t end, int thread) {
    const adam_job *j = arg;
    float *restrict x = j->values, *restrict v = j->second;
    const float *restrict g = j->gradients;
    const float b2 = j->beta2, rate = j->rate, correction = j->correction, eps = j->eps;
#pragma omp simd
    for (int64_t i = begin; i < end; i++) {
        v[i] = b2 * v[i] + (1 - b2) * g[i] * g[i];
        x[i] -= rate * g[i] / (sqrtf(v[i] * correction) + eps);
    }
}
VARIANTS(adam_range)

void adam_step(const context *c, adam *a, float *values, const float *gradients, double rate) {
    a->updates++;
    double correction = 1 / (1 - pow(adam_beta2, (double)a->updates));
    adam_job job = {values,      a->second,         gradients,      (float)adam_beta2,
                    (float)rate, (float)correction, (float)adam_eps};
    parallel_for(c, a->n, GRAIN, adam_range_best(), &job);
}

/* One partial sum a block of fixed size. */
enum { BLOCKS = 256 };
typedef struct {
    int64_t n;
    const float *gradients;
    double sum[BLOCKS];
} square_job;

static VARIANT_BODY void square_range(void *arg, int64_t begin, int64_t end, int thread) {
    square_job *j = arg;
    for (int64_t b = begin; b < end; b++) {
        double sum = 0;
#pragma omp simd reduction(+ : sum)
        for (int64_t i = j->n * b / BLOCKS; i < j->n * (b + 1) / BLOCKS; i++)
            sum += (double)j->gradients[i] * j->gradients[i];
        j->sum[b] = sum;
    }
}
VARIANTS(square_range)

double gradients_square_sum(const context *c, int64_t n, const float *gradients) {
    square_job job = {.n = n, .gradients = gradients};
    parallel_for(c, BLOCKS, 8, square_range_best(), &job);
    double sum = 0;
    for (int b = 0; b < BLOCKS; b++) sum += job.sum[b];
    return sum;
}

double schedule_rate(double rate, int64_t step, int64_t halve_every) {
    return rate * pow(0.5, (double)(step / halve_every));
}

double average_decay(int64_t step) {
    double half_life = fmin(10000.0 / 32, 0.05 * (double)step);
    return pow(0.5, 1 / fmax(half_life, 1e-8));
}

typedef struct {
    float *average;
    const float *values;
    float decay;
} average_job;

static VARIANT_BODY void average_range(void *arg, int64_t begin, int64_t end, int thread) {
    const average_job *j = arg;
    float *restrict a = j->average;
    const float *restrict x = j->values;
#pragma omp simd
    for (int64_t i = begin; i < end; i++) a[i] = x[i] + j->decay * (a[i] - x[i]);
}
VARIANTS(average_range)

void average_update(const context *c, int64_t n, float *average, const float *values, double decay) {
    average_job job = {average, values, (float)decay};
    parallel_for(c, n, GRAIN, average_range_best(), &job);
}
