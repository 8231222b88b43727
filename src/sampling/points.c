/* The samples near the body. A bit per voxel says whether any part of it is within 5 cm of a vertex, so a
 * ray's samples are tested many at a time, and only those near the shell need the exact search. */
#include <math.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "sampling/points_inside.h"

/* Lists for voxels of half the size search no faster in a picture of 512 and take three times as long to
 * make, which was half of the time of a picture of 128. */
static const float voxel_m = 0.04f;
/* Coarse frames: where pixels are closer together than this, the weights from which samples are queried are
 * larger and, in float32, only some of those of medium weight are queried: in bf16 products are cheap. */
static const float sparse_m = 0.005f;

/* A ray in the target's voxels: place = from + t * step. */
typedef struct {
    float from[3], step[3], near, span;
} voxel_ray;

static void voxel_ray_of(const points_job *job, int64_t n, voxel_ray *v) {
    const float *R = job->target->R, *d = job->rays->direction + 3 * n, *origin = job->rays->origin_world;
    float x[3];
    for (int k = 0; k < 3; k++) x[k] = origin[k] - job->target->Th[k];
    float per_cell = 1 / job->shell->cell_m;
    for (int k = 0; k < 3; k++) { /* (x - Th) R */
        v->from[k] = (x[0] * R[k] + x[1] * R[3 + k] + x[2] * R[6 + k] - job->shell->min[k]) * per_cell;
        v->step[k] = (d[0] * R[k] + d[1] * R[3 + k] + d[2] * R[6 + k]) * per_cell;
    }
    v->near = job->rays->near[n];
    v->span = job->rays->far[n] - job->rays->near[n];
}

/* Bits of the samples [first, first + count), count <= 64, that lie in a marked voxel. */
typedef uint64_t test_function(const points_job *job, const voxel_ray *v, int first, int count);

static uint64_t test_plain(const points_job *job, const voxel_ray *v, int first, int count) {
    const vertex_shell *o = job->shell;
    uint64_t bits = 0;
    for (int i = 0; i < count; i++) {
        float t = v->near + v->span * job->fraction[first + i];
        int cell[3];
        for (int k = 0; k < 3; k++) {
            float x = v->from[k] + t * v->step[k], last = (float)(o->cells[k] - 1);
            cell[k] = (int)(x > 0 ? x < last ? x : last : 0); /* NaN gives 0, which is empty */
        }
        size_t row = (size_t)cell[2] * (size_t)o->cells[1] + (size_t)cell[1];
        uint32_t word = o->bit[row * (size_t)o->words + (size_t)cell[0] / 32];
        bits |= (uint64_t)(word >> (cell[0] % 32) & 1) << i;
    }
    return bits;
}

#if defined(__x86_64__)
__attribute__((target("avx512f,avx512dq"))) static uint64_t
test_avx512(const points_job *job, const voxel_ray *v, int first, int count) {
    const vertex_shell *o = job->shell;
    uint64_t bits = 0;
    __m512 zero = _mm512_setzero_ps();
    __m512i ny = _mm512_set1_epi32(o->cells[1]), words = _mm512_set1_epi32(o->words);
    for (int i = 0; i < count; i += 16) {
        __mmask16 in = count - i < 16 ? (__mmask16)((1u << (count - i)) - 1) : (__mmask16)0xFFFF;
        __m512 t = _mm512_add_ps(
            _mm512_set1_ps(v->near),
            _mm512_mul_ps(_mm512_set1_ps(v->span), _mm512_maskz_loadu_ps(in, job->fraction + first + i)));
        __m512i cell[3];
        for (int k = 0; k < 3; k++) {
            __m512 x =
                _mm512_add_ps(_mm512_set1_ps(v->from[k]), _mm512_mul_ps(t, _mm512_set1_ps(v->step[k])));
            x = _mm512_max_ps(x, zero); /* the second operand where x is NaN */
            x = _mm512_min_ps(x, _mm512_set1_ps((float)(o->cells[k] - 1)));
            cell[k] = _mm512_cvttps_epi32(x);
        }
        __m512i row = _mm512_add_epi32(_mm512_mullo_epi32(cell[2], ny), cell[1]);
        __m512i at = _mm512_add_epi32(_mm512_mullo_epi32(row, words), _mm512_srli_epi32(cell[0], 5));
        __m512i word = _mm512_i32gather_epi32(at, o->bit, 4);
        __m512i bit =
            _mm512_sllv_epi32(_mm512_set1_epi32(1), _mm512_and_si512(cell[0], _mm512_set1_epi32(31)));
        bits |= (uint64_t)_mm512_mask_test_epi32_mask(in, word, bit) << i;
    }
    return bits;
}

__attribute__((target("avx2"))) static uint64_t test_avx2(const points_job *job, const voxel_ray *v,
                                                          int first, int count) {
    const vertex_shell *o = job->shell;
    uint64_t bits = 0;
    __m256i ny = _mm256_set1_epi32(o->cells[1]), words = _mm256_set1_epi32(o->words);
    for (int i = 0; i < count; i += 8) { /* fraction is padded */
        __m256 t =
            _mm256_add_ps(_mm256_set1_ps(v->near),
                          _mm256_mul_ps(_mm256_set1_ps(v->span), _mm256_loadu_ps(job->fraction + first + i)));
        __m256i cell[3];
        for (int k = 0; k < 3; k++) {
            __m256 x =
                _mm256_add_ps(_mm256_set1_ps(v->from[k]), _mm256_mul_ps(t, _mm256_set1_ps(v->step[k])));
            x = _mm256_max_ps(x, _mm256_setzero_ps()); /* the second operand where x is NaN */
            x = _mm256_min_ps(x, _mm256_set1_ps((float)(o->cells[k] - 1)));
            cell[k] = _mm256_cvttps_epi32(x);
        }
        __m256i row = _mm256_add_epi32(_mm256_mullo_epi32(cell[2], ny), cell[1]);
        __m256i at = _mm256_add_epi32(_mm256_mullo_epi32(row, words), _mm256_srli_epi32(cell[0], 5));
        __m256i word = _mm256_i32gather_epi32((const int *)o->bit, at, 4);
        __m256i up =
            _mm256_sub_epi32(_mm256_set1_epi32(31), _mm256_and_si256(cell[0], _mm256_set1_epi32(31)));
        unsigned set = (unsigned)_mm256_movemask_ps(_mm256_castsi256_ps(_mm256_sllv_epi32(word, up)));
        if (count - i < 8) set &= (1u << (count - i)) - 1;
        bits |= (uint64_t)set << i;
    }
    return bits;
}
#endif

static test_function *test_best(void) {
#if defined(__x86_64__)
    isa_level level = isa_best();
    if (level >= ISA_AVX512) return test_avx512;
    if (level >= ISA_AVX2) return test_avx2;
#endif
    return test_plain;
}

/* Pass 1: candidates by voxel; candidate[chunk + 1] is their number. */
static void find_candidates(const points_job *job, int64_t chunk, test_function *test) {
    int64_t count = 0;
    for (int64_t n = chunk * job->chunk; n < chunk_end(job, chunk); n++) {
        uint64_t *bits = job->sample + n * job->words;
        voxel_ray v;
        if (!job->rays->at_box[n]) {
            memset(bits, 0, (size_t)job->words * sizeof *bits);
            continue;
        }
        voxel_ray_of(job, n, &v);
        for (int w = 0; w < job->words; w++) {
            int left = job->samples - 64 * w;
            bits[w] = test(job, &v, 64 * w, left < 64 ? left : 64);
            count += __builtin_popcountll(bits[w]);
        }
    }
    job->candidate[chunk + 1] = count;
}

/* Pass 2: the exact test; `sample` keeps the bits of samples closer than 5 cm, first[n + 1] their number. */
static void keep_near(const points_job *job, int64_t chunk) {
    int32_t *nearest = job->nearest + job->candidate[chunk], total = 0;
    for (int64_t n = chunk * job->chunk; n < chunk_end(job, chunk); n++) {
        int32_t guess = -1, count = 0;
        for (int w = 0; w < job->words; w++) {
            uint64_t bits = job->sample[n * job->words + w], kept = 0;
            for (; bits; bits &= bits - 1) {
                int b = __builtin_ctzll(bits);
                float x[3];
                sample_smpl(job, n, 64 * w + b, x);
                int32_t found = vertex_grid_nearest_from(job->grid, x, guess, NULL);
                if (found < 0) continue;
                guess = found;
                kept |= (uint64_t)1 << b;
                nearest[total + count++] = found;
            }
            job->sample[n * job->words + w] = kept;
        }
        job->out->first[n + 1] = count;
        total += count;
    }
    job->kept[chunk] = total;
}

/* After pass 2: drops samples in space that the occupancy grid marks as empty. */
static void drop_empty(const points_job *job, int64_t chunk) {
    enum { SOME = 64 };
    int32_t *nearest = job->nearest + job->candidate[chunk], total = 0;
    const int32_t *from = nearest;
    float canonical[3 * SOME];
    for (int64_t n = chunk * job->chunk; n < chunk_end(job, chunk); n++) {
        int32_t count = 0;
        for (int w = 0; w < job->words; w++) {
            uint64_t kept = job->sample[n * job->words + w];
            const int some = __builtin_popcountll(kept);
            int at = 0;
            if (!some) continue;
            for (uint64_t bits = kept; bits; bits &= bits - 1)
                sample_smpl(job, n, 64 * w + __builtin_ctzll(bits), canonical + 3 * at++);
            deform_to_canonical(job->body, job->target, some, canonical, NULL, from, canonical, NULL);
            at = 0;
            for (uint64_t bits = kept; bits; bits &= bits - 1, at++) {
                if (cell_is_empty(job->empty, canonical + 3 * at))
                    kept &= ~(bits & -bits);
                else
                    nearest[total + count++] = from[at];
            }
            from += some;
            job->sample[n * job->words + w] = kept;
        }
        job->out->first[n + 1] = count;
        total += count;
    }
    job->kept[chunk] = total;
}

/* Pass 3: the kept points' numbers, places and projections. */
static void fill_points(const points_job *job, int64_t chunk) {
    enum { BATCH = 256 };
    point_set *p = job->out;
    int64_t n0 = chunk * job->chunk, at = p->first[n0], total = job->kept[chunk];
    const int32_t *nearest = job->nearest + job->candidate[chunk];
    const float *R = job->target->R;
    const uint64_t *sample = job->coarse ? job->query : job->sample;
    int64_t filled = at;
    for (int64_t n = n0; n < chunk_end(job, chunk); n++) {
        const float *d = job->rays->direction + 3 * n;
        float direction[3];
        for (int k = 0; k < 3; k++) direction[k] = d[0] * R[k] + d[1] * R[3 + k] + d[2] * R[6 + k];
        for (int w = 0; w < job->words; w++)
            for (uint64_t bits = sample[n * job->words + w]; bits; bits &= bits - 1, filled++) {
                int i = 64 * w + __builtin_ctzll(bits);
                p->ray[filled] = (int32_t)n;
                p->sample[filled] = i;
                sample_smpl(job, n, i, p->canonical + 3 * filled);
                memcpy(p->direction_canonical + 3 * filled, direction, sizeof direction);
            }
    }
    if (p->nearest) memcpy(p->nearest + at, nearest, (size_t)total * sizeof *nearest);
    const vertex_grid *grid = body_canonical_grid(job->body);
    for (int64_t b = 0; b < total; b += BATCH) {
        int64_t count = total - b < BATCH ? total - b : BATCH;
        float *canonical = p->canonical + 3 * (at + b), *direction = p->direction_canonical + 3 * (at + b);
        deform_to_canonical(job->body, job->target, count, canonical, direction, nearest + b, canonical,
                            direction);
        if (!job->observation) continue;
        int32_t canonical_nearest[BATCH];
        float own[3 * BATCH], *world = p->observation_world ? p->observation_world + 3 * (at + b) : own;
        for (int64_t i = 0; i < count; i++) /* the target's nearest vertex is almost always near here, too */
            canonical_nearest[i] = vertex_grid_nearest_from(grid, canonical + 3 * i, nearest[b + i], NULL);
        deform_to_picture(job->body, job->observation, count, canonical, canonical_nearest, world);
        camera_project(job->camera, count, world, p->observed_px + 2 * (at + b), NULL);
    }
}

static sherf_status points_allocate(context *c, const points_job *job, bool keep_stages, point_set *p) {
    size_t n = (size_t)p->count;
    p->ray = mem_alloc(c, n, sizeof *p->ray);
    p->sample = mem_alloc(c, n, sizeof *p->sample);
    p->canonical = mem_alloc(c, n, 3 * sizeof *p->canonical);
    p->direction_canonical = mem_alloc(c, n, 3 * sizeof *p->direction_canonical);
    if (!p->ray || !p->sample || !p->canonical || !p->direction_canonical) return SHERF_NO_MEMORY;
    if (job->observation && !(p->observed_px = mem_alloc(c, n, 2 * sizeof *p->observed_px)))
        return SHERF_NO_MEMORY;
    if (!keep_stages) return SHERF_OK;
    if (!(p->nearest = mem_alloc(c, n, sizeof *p->nearest))) return SHERF_NO_MEMORY;
    if (job->observation && !(p->observation_world = mem_alloc(c, n, 3 * sizeof *p->observation_world)))
        return SHERF_NO_MEMORY;
    return SHERF_OK;
}

/* Room for pass 1, and for pass 2 where its numbers do not depend on pass 1. */
static sherf_status rays_allocate(context *c, points_job *job, int64_t chunks) {
    point_set *p = job->out;
    job->fraction = mem_zero(c, (size_t)job->samples + 64, sizeof *job->fraction);
    job->sample = mem_alloc(c, (size_t)p->rays, (size_t)job->words * sizeof *job->sample);
    job->candidate = mem_zero(c, (size_t)chunks + 1, sizeof *job->candidate);
    job->kept = mem_zero(c, (size_t)chunks, sizeof *job->kept);
    p->first = mem_zero(c, (size_t)p->rays + 1, sizeof *p->first);
    if (!job->fraction || !job->sample || !job->candidate || !job->kept || !p->first) return SHERF_NO_MEMORY;
    if (!job->coarse) return SHERF_OK;
    job->query = mem_zero(c, (size_t)p->rays, (size_t)job->words * sizeof *job->query);
    job->answer->all = (point_set){.rays = p->rays, .samples = p->samples};
    job->answer->all.first = mem_zero(c, (size_t)p->rays + 1, sizeof *p->first);
    return job->query && job->answer->all.first ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status points_run(context *c, points_job *job, bool keep_stages) {
    point_set *p = job->out;
    int64_t chunks = chunk_count(job), candidates = 0;
    sherf_status status = rays_allocate(c, job, chunks);
    if (status != SHERF_OK) return status;
    for (int i = 0; i < job->samples; i++) job->fraction[i] = ray_fraction(i, job->samples);
    job->shell = vertex_grid_shell(job->grid);
    test_function *test = test_best();
#pragma omp parallel for schedule(dynamic) num_threads(c->threads)
    for (int64_t i = 0; i < chunks; i++) find_candidates(job, i, test);
    for (int64_t i = 0; i < chunks; i++) job->candidate[i + 1] = candidates += job->candidate[i + 1];
    if (candidates > INT32_MAX / 3)
        return failure(c, SHERF_BAD_ARGUMENT, "points: %lld samples near the body are too many for one frame",
                       (long long)candidates);
    if (!(job->nearest = mem_alloc(c, (size_t)candidates, sizeof *job->nearest))) return SHERF_NO_MEMORY;
    if (job->coarse && !(job->value = mem_alloc(c, (size_t)candidates, sizeof *job->value)))
        return SHERF_NO_MEMORY;
    if (job->coarse && (status = ray_lattice_create(c, job)) != SHERF_OK) return status;
#pragma omp parallel for schedule(dynamic) num_threads(c->threads)
    for (int64_t i = 0; i < chunks; i++) {
        if (job->coarse)
            points_walk(job, i);
        else
            keep_near(job, i);
        if (job->empty) drop_empty(job, i);
    }
    for (int64_t n = 0; n < p->rays; n++) p->first[n + 1] += p->first[n];
    p->count = p->first[p->rays];
    if ((status = points_allocate(c, job, keep_stages, p)) != SHERF_OK) return status;
    if (job->coarse && (status = points_allocate_coarse(c, job)) != SHERF_OK) return status;
#pragma omp parallel for schedule(dynamic) num_threads(c->threads)
    for (int64_t i = 0; i < chunks; i++) {
        fill_points(job, i);
        if (job->coarse) points_fill_coarse(job, i);
    }
    return SHERF_OK;
}

static sherf_status grid_create(context *c, const body_model *body, const posed_body *p, vertex_grid **out) {
    sherf_status status = vertex_grid_create(c, body->vertices, p->vertices_smpl, BODY_SHELL_M, out);
    if (status == SHERF_OK) status = vertex_grid_refine(c, *out, BODY_SHELL_M, voxel_m);
    if (status == SHERF_OK) return SHERF_OK;
    vertex_grid_free(*out);
    *out = NULL;
    return status;
}

sherf_status points_prepare(context *c, const body_model *body, posed_body *target) {
    return target->near ? SHERF_OK : grid_create(c, body, target, &target->near);
}

static sherf_status points_make(context *c, points_job *job, int samples, bool keep_stages, point_set **out) {
    const ray_bundle *rays = job->rays;
    *out = NULL;
    if (samples < 1 || samples > POINT_SAMPLES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "points: %d samples a ray, must be 1 to %d", samples,
                       POINT_SAMPLES_MAX);
    if (!job->observation != !job->camera)
        return failure(c, SHERF_BAD_ARGUMENT, "points: an observation needs both its body and its camera");
    job->samples = samples;
    job->words = (samples + 63) / 64;
    job->chunk = 512;
    job->out = mem_zero(c, 1, sizeof *job->out);
    if (!job->out) return SHERF_NO_MEMORY;
    job->out->rays = (int64_t)rays->width * rays->height;
    job->out->samples = samples;
    job->out->on = rays;
    vertex_grid *own = NULL;
    sherf_status status = job->target->near ? SHERF_OK : grid_create(c, job->body, job->target, &own);
    job->grid = own ? own : job->target->near;
    if (status == SHERF_OK) status = points_run(c, job, keep_stages);
    vertex_grid_free(own);
    mem_free(job->fraction);
    mem_free(job->sample);
    mem_free(job->query);
    mem_free(job->candidate);
    mem_free(job->nearest);
    mem_free(job->value);
    mem_free(job->kept);
    ray_lattice_free(&job->lattice);
    if (status == SHERF_OK)
        *out = job->out;
    else
        points_free(job->out);
    return status;
}

sherf_status points_create(context *c, const body_model *body, const posed_body *target,
                           const ray_bundle *rays, int samples, const posed_body *observation,
                           const sherf_camera *observation_camera, const occupancy_grid *empty,
                           bool keep_stages, point_set **out) {
    points_job job = {.body = body,
                      .target = target,
                      .observation = observation,
                      .camera = observation_camera,
                      .rays = rays,
                      .empty = empty && empty->bit ? empty : NULL};
    return points_make(c, &job, samples, keep_stages, out);
}

sherf_status coarse_points_create(context *c, const body_model *body, const posed_body *target,
                                  const ray_bundle *rays, int samples, float pitch_m,
                                  const posed_body *observation, const sherf_camera *observation_camera,
                                  const coarse_field *coarse, coarse_points *out) {
    const bool fine = pitch_m < sparse_m;
    points_job job = {.body = body,
                      .target = target,
                      .observation = observation,
                      .camera = observation_camera,
                      .rays = rays,
                      .pitch_m = pitch_m,
                      .coarse = coarse,
                      .heavy_per_m = fine ? 3 : 0.5f,
                      .sparse = fine && c->precision == SHERF_PRECISION_FP32,
                      .answer = out};
    *out = (coarse_points){0};
    return points_make(c, &job, samples, false, &out->queried);
}

void points_free(point_set *p) {
    if (!p) return;
    mem_free(p->first);
    mem_free(p->ray);
    mem_free(p->sample);
    mem_free(p->canonical);
    mem_free(p->direction_canonical);
    mem_free(p->observed_px);
    mem_free(p->observation_world);
    mem_free(p->nearest);
    mem_free(p->depth);
    mem_free(p);
}
