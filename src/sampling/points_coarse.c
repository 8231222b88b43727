/* The samples of a coarse frame: rays go through the coarse field, and the samples of large weight are
 * queried. */
#include <math.h>
#include <string.h>

#include "sampling/points_inside.h"

/* The total weight that a ray's samples may have without being queried. */
static const float spared = 0.1f;
/* Where only some samples are queried (`sparse`), those of a larger weight always are. */
static const float certain = 0.1f;

/* A ray's samples with density. */
typedef struct {
    int count, sample[POINT_SAMPLES_MAX];
    float weight[POINT_SAMPLES_MAX]; /* by the coarse field */
} walk;

static bool has_samples(const points_job *job, int64_t n) {
    uint64_t any = 0;
    for (int w = 0; w < job->words; w++) any |= job->sample[n * job->words + w];
    return any != 0;
}

/* Goes from front to back until the rest is hidden; writes the coarse field's values to value. */
static void walk_ray(const points_job *job, int64_t n, float delta, float (*value)[4], walk *k) {
    float light = 1;
    int32_t guess = -1;
    ray_surrounding around;
    const bool between = ray_lattice_surround(job, n, delta, &around);
    k->count = 0;
    for (int w = 0; w < job->words; w++)
        for (uint64_t bits = job->sample[n * job->words + w]; bits && light > COARSE_HIDDEN;
             bits &= bits - 1) {
            const int i = 64 * w + __builtin_ctzll(bits);
            float *v = value[k->count];
            if (!(between && ray_lattice_value(&job->lattice, &around, i, v)) &&
                !points_coarse_value(job, n, i, &guess, v))
                continue;
            if (!(v[0] > 0)) continue;
            const float passes = i + 1 < job->samples ? expf(-v[0] * delta) : 0;
            k->sample[k->count] = i;
            k->weight[k->count++] = light * (1 - passes);
            light *= passes;
        }
}

/* The weight from which samples are queried, so that the weights below it sum to at most `spared`. */
static float weight_threshold(const walk *k, float heavy) {
    for (float threshold = heavy;; threshold *= 0.7f) {
        float sum = 0;
        for (int i = 0; i < k->count; i++) sum += k->weight[i] < threshold ? k->weight[i] : 0;
        if (sum <= spared) return threshold;
    }
}

void points_walk(const points_job *job, int64_t chunk) {
    int32_t *nearest = job->nearest + job->candidate[chunk], queried = 0, guess = -1;
    float(*value)[4] = job->value + job->candidate[chunk];
    walk k;
    for (int64_t n = chunk * job->chunk; n < chunk_end(job, chunk); n++) {
        uint64_t *kept = job->sample + n * job->words, *query = job->query + n * job->words;
        const int32_t before = queried;
        const int place = (int)(n % job->rays->width + n / job->rays->width);
        if (!has_samples(job, n)) continue; /* first[n + 1] is 0 */
        const float delta = points_step_m(job, n);
        walk_ray(job, n, delta, value, &k);
        memset(kept, 0, (size_t)job->words * sizeof *kept);
        const float threshold = weight_threshold(&k, job->heavy_per_m * delta);
        for (int i = 0; i < k.count; i++) {
            const uint64_t bit = (uint64_t)1 << (k.sample[i] % 64);
            kept[k.sample[i] / 64] |= bit;
            value[i][0] =
                k.weight[i] < threshold ? value[i][0] : -value[i][0]; /* fill_coarse takes it back */
            const bool light = job->sparse && k.weight[i] < certain;
            if (k.weight[i] < threshold || (light && (place + k.sample[i]) % 2)) continue;
            float x[3];
            if (!points_nearest(job, n, k.sample[i], x, &guess)) continue; /* it was interpolated */
            query[k.sample[i] / 64] |= bit;
            nearest[queried++] = guess;
        }
        value += k.count;
        job->answer->all.first[n + 1] = k.count;
        job->out->first[n + 1] = queried - before;
    }
    job->kept[chunk] = queried;
}

void points_fill_coarse(const points_job *job, int64_t chunk) {
    coarse_points *a = job->answer;
    const float(*value)[4] = (const float(*)[4])job->value + job->candidate[chunk];
    const int64_t begin = chunk * job->chunk;
    int32_t at = a->all.first[begin], queried = job->out->first[begin];
    for (int64_t n = begin; n < chunk_end(job, chunk); n++)
        for (int w = 0; w < job->words; w++)
            for (uint64_t bits = job->sample[n * job->words + w]; bits; bits &= bits - 1, at++, value++) {
                a->all.sample[at] = 64 * w + __builtin_ctzll(bits);
                a->sigma[at] = fabsf((*value)[0]);
                for (int k = 0; k < 3; k++) a->rgb[3 * at + k] = (*value)[k + 1];
                const bool heavy = (*value)[0] < 0, query = job->query[n * job->words + w] & bits & -bits;
                a->queried_at[at] = query ? queried++ : heavy ? COARSE_MOVED : COARSE_KEPT;
            }
}

sherf_status points_allocate_coarse(context *c, points_job *job) {
    coarse_points *a = job->answer;
    point_set *all = &a->all;
    for (int64_t n = 0; n < all->rays; n++) all->first[n + 1] += all->first[n];
    all->count = all->first[all->rays];
    const size_t n = (size_t)all->count;
    all->sample = mem_alloc(c, n, sizeof *all->sample);
    a->rgb = mem_alloc(c, n, 3 * sizeof *a->rgb);
    a->sigma = mem_alloc(c, n, sizeof *a->sigma);
    a->queried_at = mem_alloc(c, n, sizeof *a->queried_at);
    return all->sample && a->rgb && a->sigma && a->queried_at ? SHERF_OK : SHERF_NO_MEMORY;
}
