/* Adam, its schedule and the moving average, over whole blocks. */
#include <math.h>

#include "tensor/cpu/variants.h"
#include "train/adam.h"

enum { GRAIN = 1 << 14 };

sherf_status adam_create(context *c, int64_t n, adam *out) {
    return adam_create_with(c, n, adam_beta1, adam_beta2, out);
}

sherf_status adam_create_with(context *c, int64_t n, double beta1, double beta2, adam *out) {
    *out = (adam){.n = n, .beta1 = beta1, .beta2 = beta2};
    out->second = mem_zero(c, (size_t)n, sizeof *out->second);
    out->sums = mem_zero(c, SQUARE_SUMS, sizeof *out->sums);
    if (beta1 > 0) out->first = mem_zero(c, (size_t)n, sizeof *out->first);
    if (out->second && out->sums && (out->first || !(beta1 > 0))) return SHERF_OK;
    adam_free(out);
    return SHERF_NO_MEMORY;
}

void adam_free(adam *a) {
    block_give(a->memory, a->first);
    block_give(a->memory, a->second);
    block_give(a->memory, a->sums);
    *a = (adam){0};
}

sherf_status adam_place(context *c, adam *a, const tensor_memory *memory) {
    const size_t bytes = (size_t)a->n * sizeof(float);
    if (!memory) return SHERF_OK;
    adam there = *a;
    there.memory = memory;
    there.second = block_take(c, memory, (size_t)a->n, sizeof(float));
    there.first = a->first ? block_take(c, memory, (size_t)a->n, sizeof(float)) : NULL;
    there.sums = block_take(c, memory, SQUARE_SUMS, sizeof(double));
    sherf_status status = there.second && there.sums ? block_upload(c, memory, there.second, a->second, bytes)
                                                     : SHERF_NO_MEMORY;
    if (status == SHERF_OK && a->first)
        status = there.first ? block_upload(c, memory, there.first, a->first, bytes) : SHERF_NO_MEMORY;
    adam_free(status == SHERF_OK ? a : &there);
    if (status == SHERF_OK) *a = there;
    return status;
}

typedef struct {
    float *values, *first, *second;
    const float *gradients;
    adam_factors factors;
} adam_job;

static VARIANT_BODY void adam_range(void *arg, int64_t begin, int64_t end, int thread) {
    const adam_job *j = arg;
    float *restrict x = j->values, *restrict v = j->second;
    const float *restrict g = j->gradients;
    const float b2 = j->factors.beta2, rate = j->factors.rate;
    const float correction = j->factors.correction, eps = j->factors.eps;
#pragma omp simd
    for (int64_t i = begin; i < end; i++) {
        v[i] = b2 * v[i] + (1 - b2) * g[i] * g[i];
        x[i] -= rate * g[i] / (sqrtf(v[i] * correction) + eps);
    }
}
VARIANTS(adam_range)

static VARIANT_BODY void momentum_range(void *arg, int64_t begin, int64_t end, int thread) {
    const adam_job *j = arg;
    float *restrict x = j->values, *restrict m = j->first, *restrict v = j->second;
    const float *restrict g = j->gradients;
    const float b1 = j->factors.beta1, b2 = j->factors.beta2, rate = j->factors.rate * j->factors.correction1;
    const float correction = j->factors.correction, eps = j->factors.eps;
#pragma omp simd
    for (int64_t i = begin; i < end; i++) {
        m[i] = b1 * m[i] + (1 - b1) * g[i];
        v[i] = b2 * v[i] + (1 - b2) * g[i] * g[i];
        x[i] -= rate * m[i] / (sqrtf(v[i] * correction) + eps);
    }
}
VARIANTS(momentum_range)

sherf_status adam_step(context *c, adam *a, float *values, const float *gradients, double rate) {
    a->updates++;
    const double correction = 1 / (1 - pow(a->beta2, (double)a->updates));
    const double correction1 = 1 / (1 - pow(a->beta1, (double)a->updates));
    const adam_factors f = {.beta1 = (float)a->beta1,
                            .beta2 = (float)a->beta2,
                            .rate = (float)rate,
                            .correction1 = (float)correction1,
                            .correction = (float)correction,
                            .eps = (float)adam_eps};
    if (a->memory) return a->memory->blocks->adam(c, a->n, values, a->first, a->second, gradients, f);
    adam_job job = {values, a->first, a->second, gradients, f};
    parallel_for(c, a->n, GRAIN, a->first ? momentum_range_best() : adam_range_best(), &job);
    return SHERF_OK;
}

typedef struct {
    int64_t n;
    const float *gradients;
    double *sum;
} square_job;

static VARIANT_BODY void square_range(void *arg, int64_t begin, int64_t end, int thread) {
    square_job *j = arg;
    for (int64_t b = begin; b < end; b++) {
        double sum = 0;
#pragma omp simd reduction(+ : sum)
        for (int64_t i = j->n * b / SQUARE_SUMS; i < j->n * (b + 1) / SQUARE_SUMS; i++)
            sum += (double)j->gradients[i] * j->gradients[i];
        j->sum[b] = sum;
    }
}
VARIANTS(square_range)

sherf_status gradients_square_sum(context *c, const adam *a, const float *gradients, double *out) {
    double sums[SQUARE_SUMS];
    square_job job = {a->n, gradients, a->sums};
    sherf_status status = SHERF_OK;
    if (a->memory)
        status = a->memory->blocks->square_sums(c, a->n, gradients, a->sums);
    else
        parallel_for(c, SQUARE_SUMS, 8, square_range_best(), &job);
    if (status == SHERF_OK) status = block_download(c, a->memory, sums, a->sums, sizeof sums);
    *out = 0;
    for (int b = 0; b < SQUARE_SUMS && status == SHERF_OK; b++) *out += sums[b];
    return status;
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

sherf_status average_update(context *c, const tensor_memory *memory, int64_t n, float *average,
                            const float *values, double decay) {
    if (memory) return memory->blocks->average(c, n, average, values, (float)decay);
    average_job job = {average, values, (float)decay};
    parallel_for(c, n, GRAIN, average_range_best(), &job);
    return SHERF_OK;
}
