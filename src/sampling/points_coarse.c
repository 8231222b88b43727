/* The samples of a coarse frame: rays go through the coarse field, and the samples of large weight are
 * queried. */
#include <math.h>
#include <string.h>

#include "sampling/points_inside.h"

/* Transmittance below which the rest of a ray is hidden; the total weight that samples may have without being
 * queried. */
static const float hidden = 3e-3f, spared = 0.1f;
/* Where pixels are closer together than this, the weights from which samples are queried are larger and, in
 * float32, only every other one is queried: in bf16 products are cheap. */
static const float sparse_m = 0.005f;

/* Samples of a ray that are near the body, from front to back. */
typedef struct {
    int count, sample[8];
    int32_t nearest[8];
    float place[3 * 8];
} walk_step;

/* Takes a word's next candidates; skips those not near the body. */
static uint64_t step_on(const points_job *job, int64_t n, int word, uint64_t bits, int32_t *guess,
                        walk_step *s) {
    for (s->count = 0; bits && s->count < (int)COUNT_OF(s->sample); bits &= bits - 1) {
        float *x = s->place + 3 * s->count;
        s->sample[s->count] = 64 * word + __builtin_ctzll(bits);
        sample_smpl(job, n, s->sample[s->count], x);
        const int32_t found = vertex_grid_nearest_from(job->grid, x, *guess, NULL);
        if (found < 0) continue;
        s->nearest[s->count++] = *guess = found;
    }
    deform_to_canonical(job->body, job->target, s->count, s->place, NULL, s->nearest, s->place, NULL);
    return bits;
}

/* A ray's samples with density. */
typedef struct {
    int count, sample[POINT_SAMPLES_MAX];
    int32_t nearest[POINT_SAMPLES_MAX];
    float weight[POINT_SAMPLES_MAX]; /* by the coarse field */
} walk;

/* Metres between two samples. */
static float step_of(const points_job *job, int64_t n) {
    const ray_bundle *r = job->rays;
    const float *d = r->direction + 3 * n;
    const float step = job->samples > 1 ? (r->far[n] - r->near[n]) / (float)(job->samples - 1) : 0;
    return step * sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
}

/* Goes from front to back until the rest is hidden; writes the coarse field's values to value. */
static void walk_ray(const points_job *job, int64_t n, float (*value)[4], walk *k) {
    const float delta = step_of(job, n);
    float light = 1;
    int32_t guess = -1;
    walk_step s;
    k->count = 0;
    for (int w = 0; w < job->words; w++) {
        uint64_t bits = job->sample[n * job->words + w];
        while (bits && light > hidden) {
            bits = step_on(job, n, w, bits, &guess, &s);
            for (int i = 0; i < s.count && light > hidden; i++) {
                coarse_at(job->coarse, s.place + 3 * i, value[k->count]);
                const float sigma = value[k->count][0];
                if (!(sigma > 0)) continue;
                const float passes = s.sample[i] + 1 < job->samples ? expf(-sigma * delta) : 0;
                k->sample[k->count] = s.sample[i];
                k->nearest[k->count] = s.nearest[i];
                k->weight[k->count++] = light * (1 - passes);
                light *= passes;
            }
        }
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
    int32_t *nearest = job->nearest + job->candidate[chunk], queried = 0;
    float(*value)[4] = job->value + job->candidate[chunk];
    walk k;
    for (int64_t n = chunk * job->chunk; n < chunk_end(job, chunk); n++) {
        uint64_t *kept = job->sample + n * job->words, *query = job->query + n * job->words;
        const int32_t before = queried;
        const int place = (int)(n % job->rays->width + n / job->rays->width);
        walk_ray(job, n, value, &k);
        memset(kept, 0, (size_t)job->words * sizeof *kept);
        const float threshold = weight_threshold(&k, job->heavy_per_m * step_of(job, n));
        for (int i = 0; i < k.count; i++) {
            const uint64_t bit = (uint64_t)1 << (k.sample[i] % 64);
            kept[k.sample[i] / 64] |= bit;
            value[i][0] =
                k.weight[i] < threshold ? value[i][0] : -value[i][0]; /* fill_coarse takes it back */
            if (k.weight[i] < threshold || (job->sparse && (place + k.sample[i]) % 2)) continue;
            query[k.sample[i] / 64] |= bit;
            nearest[queried++] = k.nearest[i];
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

sherf_status coarse_points_create(context *c, const body_model *body, const posed_body *target,
                                  const ray_bundle *rays, int samples, const posed_body *observation,
                                  const sherf_camera *observation_camera, const coarse_field *coarse,
                                  coarse_points *out) {
    const bool fine = rays_pitch(rays) < sparse_m;
    points_job job = {.body = body,
                      .target = target,
                      .observation = observation,
                      .camera = observation_camera,
                      .rays = rays,
                      .coarse = coarse,
                      .heavy_per_m = fine ? 3 : 0.5f,
                      .sparse = fine && c->precision == SHERF_PRECISION_FP32,
                      .answer = out};
    *out = (coarse_points){0};
    return points_make(c, &job, samples, false, &out->queried);
}
