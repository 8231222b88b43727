/* Rays through the pixels, and their crossings with the body's box (network.md: Rays and points, 1). */
#include <math.h>
#include <string.h>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "scene/ray.h"

void body_world_box(const body_model *body, const posed_body *p, float min_world[3], float max_world[3]) {
    for (int k = 0; k < 3; k++) min_world[k] = INFINITY, max_world[k] = -INFINITY;
    for (size_t v = 0; v < (size_t)body->vertices; v++) {
        const float *x = p->vertices_smpl + 3 * v;
        for (int k = 0; k < 3; k++) { /* as body_vertices_world */
            float y = p->R[3 * k] * x[0] + p->R[3 * k + 1] * x[1] + p->R[3 * k + 2] * x[2] + p->Th[k];
            if (y < min_world[k]) min_world[k] = y;
            if (y > max_world[k]) max_world[k] = y;
        }
    }
    for (int k = 0; k < 3; k++) min_world[k] -= BODY_SHELL_M, max_world[k] += BODY_SHELL_M;
}

typedef struct {
    ray_bundle *r;
    ray_optics optics;
    float min[3], max[3];
    bool wide; /* sixteen columns at a time */
} ray_job;

static void invert(const float K[9], float out[9]) {
    double a[9];
    for (int i = 0; i < 9; i++) a[i] = K[i];
    double c0 = a[4] * a[8] - a[5] * a[7], c1 = a[5] * a[6] - a[3] * a[8], c2 = a[3] * a[7] - a[4] * a[6];
    double det = a[0] * c0 + a[1] * c1 + a[2] * c2;
    double adjugate[9] = {c0, a[2] * a[7] - a[1] * a[8], a[1] * a[5] - a[2] * a[4],
                          c1, a[0] * a[8] - a[2] * a[6], a[2] * a[3] - a[0] * a[5],
                          c2, a[1] * a[6] - a[0] * a[7], a[0] * a[4] - a[1] * a[3]};
    for (int i = 0; i < 9; i++) out[i] = (float)(adjugate[i] / det);
}

void ray_optics_of(const sherf_camera *camera, ray_optics *out) {
    invert(camera->K, out->K_inverse);
    memcpy(out->R, camera->R, sizeof out->R);
    memcpy(out->T_m, camera->T_m, sizeof out->T_m);
    camera_position(camera, out->origin);
}

static void ray_job_init(ray_job *job, const sherf_camera *camera, const float min_world[3],
                         const float max_world[3]) {
    ray_optics_of(camera, &job->optics);
    for (int k = 0; k < 3; k++)
        job->min[k] = min_world[k] - BOX_SPARE_M, job->max[k] = max_world[k] + BOX_SPARE_M;
}

/* True if the ray has two crossings. */
static bool make_ray(const ray_job *job, int column, int row, float direction[3], float *near, float *far) {
    ray_direction(&job->optics, column, row, direction);
    return cross_box(job->optics.origin, direction, job->min, job->max, near, far);
}

/* Makes the rays of a row's columns from `column` on. */
static void make_some(const ray_job *job, int row, int column) {
    ray_bundle *r = job->r;
    for (; column < r->width; column++) {
        size_t n = (size_t)row * (size_t)r->width + (size_t)column;
        r->near[n] = 0, r->far[n] = 1;
        r->at_box[n] = make_ray(job, column, row, r->direction + 3 * n, r->near + n, r->far + n);
    }
}

#if defined(__x86_64__)
#define AVX512 __attribute__((target("avx512f,avx512dq,avx512bw")))

/* As ray_direction for sixteen columns, operation by operation. */
AVX512 static void directions_avx512(const ray_optics *o, int column, int row, __m512 out[3]) {
    __m512 p[3], x = _mm512_cvtepi32_ps(_mm512_add_epi32(
                     _mm512_set1_epi32(column),
                     _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)));
    for (int k = 0; k < 3; k++) {
        p[k] = _mm512_add_ps(_mm512_mul_ps(_mm512_set1_ps(o->K_inverse[3 * k]), x),
                             _mm512_set1_ps(o->K_inverse[3 * k + 1] * (float)row));
        p[k] = _mm512_add_ps(p[k], _mm512_set1_ps(o->K_inverse[3 * k + 2]));
        p[k] = _mm512_sub_ps(p[k], _mm512_set1_ps(o->T_m[k]));
    }
    for (int k = 0; k < 3; k++) {
        __m512 d = _mm512_mul_ps(_mm512_set1_ps(o->R[k]), p[0]);
        d = _mm512_add_ps(d, _mm512_mul_ps(_mm512_set1_ps(o->R[3 + k]), p[1]));
        d = _mm512_add_ps(d, _mm512_mul_ps(_mm512_set1_ps(o->R[6 + k]), p[2]));
        out[k] = _mm512_sub_ps(d, _mm512_set1_ps(o->origin[k]));
    }
}

/* As cross_box for sixteen directions: which cross the box, and where. */
AVX512 static __mmask16 cross_box_avx512(const ray_job *job, const __m512 direction[3], __m512 *near,
                                         __m512 *far) {
    const float spare = 1e-6f, *from = job->optics.origin;
    const __m512 zero = _mm512_setzero_ps();
    __m512 first = zero, second = zero;
    __mmask16 one = 0, two = 0, more = 0; /* crossings so far: at least this many */
    for (int face = 0; face < 6; face++) {
        const int k = face % 3;
        __mmask16 inside = _mm512_cmp_ps_mask(direction[k], zero, _CMP_NEQ_UQ);
        const __m512 at =
            _mm512_div_ps(_mm512_set1_ps((face < 3 ? job->min[k] : job->max[k]) - from[k]), direction[k]);
        for (int a = 0; a < 3; a++) {
            const __m512 x = _mm512_add_ps(_mm512_mul_ps(at, direction[a]), _mm512_set1_ps(from[a]));
            inside = _mm512_mask_cmp_ps_mask(inside, x, _mm512_set1_ps(job->min[a] - spare), _CMP_GE_OQ);
            inside = _mm512_mask_cmp_ps_mask(inside, x, _mm512_set1_ps(job->max[a] + spare), _CMP_LE_OQ);
        }
        more |= two & inside;
        second = _mm512_mask_mov_ps(second, one & inside, at);
        two |= one & inside;
        first = _mm512_mask_mov_ps(first, ~one & inside, at);
        one |= inside;
    }
    const __mmask16 ordered = _mm512_cmp_ps_mask(first, second, _CMP_LT_OQ);
    const __m512 low = _mm512_mask_mov_ps(second, ordered, first);
    *far = _mm512_mask_mov_ps(first, ordered, second);
    *near = _mm512_maskz_mov_ps(_mm512_cmp_ps_mask(low, zero, _CMP_GT_OQ), low);
    return two & ~more & _mm512_cmp_ps_mask(*far, zero, _CMP_GT_OQ);
}

/* Makes whole sixteens of a row; returns the first remaining column. */
AVX512 static int make_sixteens(const ray_job *job, int row) {
    ray_bundle *r = job->r;
    int column = 0;
    for (; column + 16 <= r->width; column += 16) {
        const size_t n = (size_t)row * (size_t)r->width + (size_t)column;
        __m512 d[3], near, far;
        float direction[3][16];
        directions_avx512(&job->optics, column, row, d);
        const __mmask16 met = cross_box_avx512(job, d, &near, &far);
        for (int k = 0; k < 3; k++) _mm512_storeu_ps(direction[k], d[k]);
        for (int i = 0; i < 16; i++)
            for (int k = 0; k < 3; k++) r->direction[3 * (n + (size_t)i) + (size_t)k] = direction[k][i];
        _mm512_storeu_ps(r->near + n, _mm512_maskz_mov_ps(met, near));
        _mm512_storeu_ps(r->far + n, _mm512_mask_mov_ps(_mm512_set1_ps(1), met, far));
        _mm_storeu_si128((__m128i *)(r->at_box + n), _mm512_maskz_cvtepi32_epi8(met, _mm512_set1_epi32(1)));
    }
    return column;
}
#endif

static void make_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const ray_job *job = arg;
    for (int row = (int)begin; row < end; row++) {
        int column = 0;
#if defined(__x86_64__)
        if (job->wide) column = make_sixteens(job, row);
#endif
        make_some(job, row, column);
    }
}

void box_ray_mask(const sherf_camera *camera, const float min_world[3], const float max_world[3],
                  uint8_t *mask) {
    ray_job job = {0};
    ray_job_init(&job, camera, min_world, max_world);
    for (int row = 0; row < camera->height_px; row++)
        for (int column = 0; column < camera->width_px; column++) {
            float direction[3], near, far;
            mask[(size_t)row * (size_t)camera->width_px + (size_t)column] =
                make_ray(&job, column, row, direction, &near, &far);
        }
}

sherf_status rays_create(context *c, const sherf_camera *camera, const float min_world[3],
                         const float max_world[3], ray_bundle **out) {
    *out = NULL;
    sherf_status status = camera_check(c, camera);
    if (status != SHERF_OK) return status;
    size_t n = (size_t)camera->width_px * (size_t)camera->height_px;
    ray_bundle *r = mem_zero(c, 1, sizeof *r);
    if (!r) return SHERF_NO_MEMORY;
    r->width = camera->width_px;
    r->height = camera->height_px;
    r->camera = *camera;
    r->direction = mem_alloc(c, n, 3 * sizeof *r->direction);
    r->near = mem_alloc(c, n, sizeof *r->near);
    r->far = mem_alloc(c, n, sizeof *r->far);
    r->at_box = mem_alloc(c, n, sizeof *r->at_box);
    if (!r->direction || !r->near || !r->far || !r->at_box) {
        rays_free(r);
        return SHERF_NO_MEMORY;
    }
    ray_job job = {.r = r, .wide = isa_best() >= ISA_AVX512};
    ray_job_init(&job, camera, min_world, max_world);
    memcpy(r->origin_world, job.optics.origin, sizeof r->origin_world);
    parallel_for(c, r->height, 8, make_rows, &job);
    *out = r;
    return SHERF_OK;
}

static float length3(const float v[3]) {
    return sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

typedef struct {
    ray_bundle *r;
    float min[3], max[3];
} repair_job;

static void repair_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const repair_job *j = arg;
    const ray_bundle *r = j->r;
    for (int64_t i = begin * r->width; i < end * r->width; i++)
        if (cross_slabs(r->origin_world, r->direction + 3 * i, j->min, j->max, r->near + i, r->far + i))
            r->at_box[i] = 1;
}

void rays_repair(const context *c, ray_bundle *r, const float min_world[3], const float max_world[3]) {
    repair_job job = {.r = r};
    for (int k = 0; k < 3; k++)
        job.min[k] = min_world[k] - BOX_SPARE_M, job.max[k] = max_world[k] + BOX_SPARE_M;
    parallel_for(c, r->height, 8, repair_rows, &job);
}

ray_extent rays_extent(const context *c, const ray_bundle *r) {
    const int64_t count = (int64_t)r->width * r->height;
    float nearest = INFINITY, farthest = -INFINITY, longest = 0;
#pragma omp parallel for reduction(min : nearest) reduction(max : farthest, longest) num_threads(c->threads)
    for (int64_t i = 0; i < count; i++) {
        const float near = r->near[i], far = r->far[i];
        farthest = far > farthest ? far : farthest;
        if (!r->at_box[i]) continue;
        const float way = (far - near) * length3(r->direction + 3 * i);
        nearest = near < nearest ? near : nearest;
        longest = way > longest ? way : longest;
    }
    return (ray_extent){nearest, farthest, longest};
}

int rays_even_steps(const context *c, ray_bundle *r, float longest_m, int samples, int max, float step_m) {
    if (samples < 2 || !(longest_m > step_m * (float)(samples - 1))) return samples;
    const float needed = ceilf(longest_m / step_m) + 1;
    const int count = needed < (float)max ? (int)needed : max > samples ? max : samples;
    const float step = fmaxf(step_m, longest_m / (float)(count - 1));
    const int64_t rays = (int64_t)r->width * r->height;
#pragma omp parallel for num_threads(c->threads)
    for (int64_t i = 0; i < rays; i++) {
        const float own = (r->far[i] - r->near[i]) / (float)(samples - 1);
        if (!r->at_box[i]) continue;
        const float even = step / length3(r->direction + 3 * i);
        r->far[i] = r->near[i] + (own < even ? own : even) * (float)(count - 1);
    }
    return count;
}

void rays_free(ray_bundle *r) {
    if (!r) return;
    mem_free(r->direction);
    mem_free(r->near);
    mem_free(r->far);
    mem_free(r->at_box);
    mem_free(r);
}

float rays_pitch(const ray_bundle *r, float nearest) {
    float apart = 0;
    for (int k = 0; k < 3 && r->width > 1; k++) {
        const float d = r->direction[3 + k] - r->direction[k];
        apart += d * d;
    }
    return r->width > 1 && nearest < INFINITY ? sqrtf(apart) * nearest : INFINITY;
}
