/* Colours of a surface, as a camera in front of each place would see it: short rays along the normals, from
 * slightly outside to slightly inside, are composited as in a frame. */
#include <math.h>
#include <string.h>

#include "baked/baked.h"
#include "avatar/canonical.h"
#include "avatar/detail.h"

/* Frames have a sample every 10 to 20 mm. These rays are finer, and end when they have passed most of a
 * surface's opacity. Dividing by the opacity corrects for the rest. */
enum { RAY_SAMPLES = 10, RAYS_WIDE = 256, RAYS_HIGH = 64, RAYS = RAYS_WIDE * RAYS_HIGH };
static const float ray_start_m = 0.01f, ray_step_m = 0.005f;

typedef struct {
    const sherf_avatar *a;
    const body_model *body;
    const float *position, *normal; /* of the batch */
    int64_t rays;
    ray_bundle bundle;
    point_set set;
    int32_t *nearest; /* RAYS x RAY_SAMPLES; -1: outside the shell */
    sherf_frame frame;
} bake_job;

static void find_samples(void *arg, int64_t begin, int64_t end, int thread) {
    bake_job *j = arg;
    for (int64_t n = begin; n < end; n++) {
        int32_t guess = -1, count = 0;
        for (int i = 0; i < RAY_SAMPLES; i++) {
            float d2, p[3];
            for (int k = 0; k < 3; k++)
                p[k] = j->position[3 * n + k] + (ray_start_m - ray_step_m * (float)i) * j->normal[3 * n + k];
            int32_t found = vertex_grid_nearest_from(body_canonical_grid(j->body), p, guess, &d2);
            guess = found;
            if (!(found >= 0 && d2 < BODY_SHELL_M * BODY_SHELL_M)) found = -1;
            j->nearest[n * RAY_SAMPLES + i] = found;
            count += found >= 0;
        }
        j->set.first[n + 1] = count;
    }
}

static void fill_samples(void *arg, int64_t begin, int64_t end, int thread) {
    bake_job *j = arg;
    for (int64_t n = begin; n < end; n++) {
        int64_t at = j->set.first[n], count = 0;
        int32_t nearest[RAY_SAMPLES];
        for (int i = 0; i < RAY_SAMPLES; i++) {
            int32_t found = j->nearest[n * RAY_SAMPLES + i];
            if (found < 0) continue;
            for (int k = 0; k < 3; k++) {
                float normal = j->normal[3 * n + k];
                j->set.canonical[3 * (at + count) + k] =
                    j->position[3 * n + k] + (ray_start_m - ray_step_m * (float)i) * normal;
                j->set.direction_canonical[3 * (at + count) + k] = -normal;
            }
            j->set.ray[at + count] = (int32_t)n;
            j->set.sample[at + count] = i;
            nearest[count++] = found;
        }
        canonical_observe(j->a, j->body, count, j->set.canonical + 3 * at, nearest,
                          j->set.observed_px + 2 * at);
    }
}

static sherf_status job_make(context *c, bake_job *j) {
    const size_t points = (size_t)RAYS * RAY_SAMPLES;
    j->set.samples = RAY_SAMPLES + 1; /* the last depth, to infinity, has no point */
    j->set.rays = RAYS;
    j->set.first = mem_zero(c, RAYS + 1, sizeof *j->set.first);
    j->set.ray = mem_alloc(c, points, sizeof *j->set.ray);
    j->set.sample = mem_alloc(c, points, sizeof *j->set.sample);
    j->set.canonical = mem_alloc(c, points, 3 * sizeof(float));
    j->set.direction_canonical = mem_alloc(c, points, 3 * sizeof(float));
    j->set.observed_px = mem_alloc(c, points, 2 * sizeof(float));
    j->nearest = mem_alloc(c, points, sizeof *j->nearest);
    j->bundle.width = RAYS_WIDE;
    j->bundle.height = RAYS_HIGH;
    j->bundle.direction = mem_zero(c, RAYS, 3 * sizeof(float));
    j->bundle.near = mem_zero(c, RAYS, sizeof(float));
    j->bundle.far = mem_alloc(c, RAYS, sizeof(float));
    if (!j->set.first || !j->set.ray || !j->set.sample || !j->set.canonical || !j->set.direction_canonical ||
        !j->set.observed_px || !j->nearest || !j->bundle.direction || !j->bundle.near || !j->bundle.far)
        return SHERF_NO_MEMORY;
    for (int n = 0; n < RAYS; n++) {
        j->bundle.direction[3 * n] = 1; /* only lengths matter */
        j->bundle.far[n] = ray_step_m * RAY_SAMPLES;
    }
    return SHERF_OK;
}

static void job_free(bake_job *j) {
    mem_free(j->set.first);
    mem_free(j->set.ray);
    mem_free(j->set.sample);
    mem_free(j->set.canonical);
    mem_free(j->set.direction_canonical);
    mem_free(j->set.observed_px);
    mem_free(j->nearest);
    mem_free(j->bundle.direction);
    mem_free(j->bundle.near);
    mem_free(j->bundle.far);
    sherf_frame_free(&j->frame);
}

static sherf_status bake_batch(context *c, bake_job *j, float *rgb) {
    static const float black[3] = {0, 0, 0};
    parallel_for(c, j->rays, 64, find_samples, j);
    for (int64_t n = 0; n < j->rays; n++) j->set.first[n + 1] += j->set.first[n];
    for (int64_t n = j->rays; n < RAYS; n++) j->set.first[n + 1] = j->set.first[j->rays];
    j->set.count = j->set.first[RAYS];
    parallel_for(c, j->rays, 64, fill_samples, j);
    sherf_status status = avatar_composite(c, j->a, j->body, &j->bundle, &j->set, black, true, &j->frame);
    if (status != SHERF_OK) return status;
    for (int64_t n = 0; n < j->rays; n++) {
        float opacity = j->frame.opacity.data[n];
        for (int k = 0; k < 3; k++) {
            float color = opacity > 1e-3f ? j->frame.color.data[3 * n + k] / opacity : 0;
            rgb[3 * n + k] = fminf(fmaxf(color, 0), 1);
        }
    }
    return SHERF_OK;
}

typedef struct {
    const body_model *body;
    const avatar_detail *d;
    const float *position, *body_normal; /* of the canonical vertices */
    float *rgb;
} detail_job;

/* A place that haze has let sink into the body is moved to the surface at its nearest vertex. */
static void raise_to_body(const body_model *body, int32_t nearest, const float *body_normal, float p[3]) {
    if (nearest < 0) return;
    const float *v = body->canonical->vertices_smpl + 3 * (size_t)nearest,
                *n = body_normal + 3 * (size_t)nearest;
    const float above = (p[0] - v[0]) * n[0] + (p[1] - v[1]) * n[1] + (p[2] - v[2]) * n[2];
    for (int k = 0; k < 3 && above < 0; k++) p[k] -= above * n[k];
}

static void detail_range(void *arg, int64_t begin, int64_t end, int thread) {
    const detail_job *j = arg;
    int32_t guess = -1;
    for (int64_t n = begin; n < end; n++) {
        float p[3];
        detail_gift gift;
        memcpy(p, j->position + 3 * n, sizeof p);
        guess = vertex_grid_nearest_from(body_canonical_grid(j->body), p, guess, NULL);
        raise_to_body(j->body, guess, j->body_normal, p);
        detail_look_up(j->d, j->body, 1, p, &guess, &gift);
        detail_give(j->d, &gift, gift.seen, gift.lent, 1 - gift.seen, j->rgb + 3 * n);
    }
}

sherf_status bake_detail(context *c, const sherf_avatar *a, const body_model *body, int64_t n,
                         const float *positions_canonical, float *rgb) {
    float *normal = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *normal);
    detail_job j = {body, NULL, positions_canonical, normal, rgb};
    sherf_status status = normal ? avatar_detail_of(c, a, body, &j.d) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = body_normals(c, body, body->canonical->vertices_smpl, normal);
    if (status == SHERF_OK) parallel_for(c, n, 1024, detail_range, &j);
    mem_free(normal);
    return status;
}

sherf_status bake_colors(context *c, const sherf_avatar *a, const body_model *body, int64_t n,
                         const float *positions_canonical, const float *normals_canonical, float *rgb) {
    bake_job *j = mem_zero(c, 1, sizeof *j);
    if (!j) return SHERF_NO_MEMORY;
    j->a = a;
    j->body = body;
    sherf_status status = job_make(c, j);
    for (int64_t at = 0; at < n && status == SHERF_OK; at += RAYS) {
        j->rays = n - at < RAYS ? n - at : RAYS;
        j->position = positions_canonical + 3 * at;
        j->normal = normals_canonical + 3 * at;
        status = bake_batch(c, j, rgb + 3 * at);
        if (status == SHERF_OK) status = progress(c, "colours", (double)(at + j->rays), (double)n);
    }
    job_free(j);
    mem_free(j);
    return status;
}
