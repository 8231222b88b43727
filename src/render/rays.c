/* Rays through the pixels, and where they cross the body's box (network.md: Rays and points, 1). */
#include <math.h>
#include <string.h>

#include "render/ray.h"

void body_world_box(const body_model *m, const posed_body *p, float min_world[3], float max_world[3]) {
    for (int k = 0; k < 3; k++) min_world[k] = INFINITY, max_world[k] = -INFINITY;
    for (size_t v = 0; v < (size_t)m->vertices; v++) {
        const float *x = p->vertices_smpl + 3 * v;
        for (int k = 0; k < 3; k++) { /* as body_vertices_world */
            float y = p->R[3 * k] * x[0] + p->R[3 * k + 1] * x[1] + p->R[3 * k + 2] * x[2] + p->Th[k];
            if (y < min_world[k]) min_world[k] = y;
            if (y > max_world[k]) max_world[k] = y;
        }
    }
    for (int k = 0; k < 3; k++) min_world[k] -= 0.05f, max_world[k] += 0.05f;
}

typedef struct {
    ray_bundle *r;
    ray_optics optics;
    float min[3], max[3];
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
    for (int k = 0; k < 3; k++) job->min[k] = min_world[k] - 0.01f, job->max[k] = max_world[k] + 0.01f;
}

/* True when the ray has its two crossings. */
static bool make_ray(const ray_job *job, int column, int row, float direction[3], float *near, float *far) {
    ray_direction(&job->optics, column, row, direction);
    return cross_box(job->optics.origin, direction, job->min, job->max, near, far);
}

static void make_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const ray_job *job = arg;
    ray_bundle *r = job->r;
    for (int row = (int)begin; row < end; row++)
        for (int column = 0; column < r->width; column++) {
            size_t n = (size_t)row * (size_t)r->width + (size_t)column;
            r->near[n] = 0, r->far[n] = 1;
            r->at_box[n] = make_ray(job, column, row, r->direction + 3 * n, r->near + n, r->far + n);
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
    r->direction = mem_alloc(c, n, 3 * sizeof *r->direction);
    r->near = mem_alloc(c, n, sizeof *r->near);
    r->far = mem_alloc(c, n, sizeof *r->far);
    r->at_box = mem_alloc(c, n, sizeof *r->at_box);
    if (!r->direction || !r->near || !r->far || !r->at_box) {
        rays_free(r);
        return SHERF_NO_MEMORY;
    }
    ray_job job = {.r = r};
    ray_job_init(&job, camera, min_world, max_world);
    memcpy(r->origin_world, job.optics.origin, sizeof r->origin_world);
    parallel_for(c, r->height, 8, make_rows, &job);
    *out = r;
    return SHERF_OK;
}

static float length3(const float v[3]) {
    return sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

int rays_even_steps(ray_bundle *r, int samples, int most, float step_m) {
    const size_t n = (size_t)r->width * (size_t)r->height;
    float longest = 0;
    for (size_t i = 0; i < n; i++)
        if (r->at_box[i]) longest = fmaxf(longest, (r->far[i] - r->near[i]) * length3(r->direction + 3 * i));
    if (samples < 2 || !(longest > step_m * (float)(samples - 1))) return samples;
    const float needed = ceilf(longest / step_m) + 1;
    const int count = needed < (float)most ? (int)needed : most > samples ? most : samples;
    const float step = fmaxf(step_m, longest / (float)(count - 1));
    for (size_t i = 0; i < n; i++) {
        const float own = (r->far[i] - r->near[i]) / (float)(samples - 1);
        if (r->at_box[i])
            r->far[i] = r->near[i] + fminf(own, step / length3(r->direction + 3 * i)) * (float)(count - 1);
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
