/* Geometry: what the body and the cameras determine before any weight is used. */
#include <math.h>
#include <string.h>

#include "model/model.h"

sherf_status observation_geometry_of(context *c, const model_config *config, const body_model *body,
                                     int count, const observed_picture *picture, bool training,
                                     observation_geometry **out) {
    observed_sheet sheet;
    *out = NULL;
    observation_geometry *g = mem_zero(c, 1, sizeof *g);
    if (!g) return SHERF_NO_MEMORY;
    g->kind = config->kind;
    g->vertices = body->vertices;
    sherf_status status = observed_sheet_create(c, config, body, count, picture, &sheet);
    if (status == SHERF_OK) {
        g->width = sheet.width;
        g->height = sheet.height;
        g->image = sheet.image;
        g->camera = sheet.camera;
        g->body = sheet.body;
        if (config->kind->observe) status = config->kind->observe(c, config, body, training, g);
    }
    if (status == SHERF_OK)
        *out = g;
    else
        observation_geometry_free(g);
    return status;
}

sherf_status observation_geometry_create(context *c, const model_config *config, const body_model *body,
                                         const sherf_image *image_rgb, const sherf_camera *camera,
                                         const sherf_pose *pose, bool training, observation_geometry **out) {
    const observed_picture one = {*image_rgb, *camera, *pose};
    return observation_geometry_of(c, config, body, 1, &one, training, out);
}

void observation_geometry_free(observation_geometry *g) {
    if (!g) return;
    mem_free(g->image);
    posed_body_free(g->body);
    if (g->kind->observed_free) g->kind->observed_free(g->own);
    mem_free(g);
}

static bool same_pose(const body_model *body, const posed_body *a, const posed_body *b) {
    const float max = 1e-4f; /* metres: rounding of a file round trip */
    float far = 0;
    for (int64_t i = 0; i < 3 * (int64_t)body->vertices; i++)
        far = fmaxf(far, fabsf(a->vertices_smpl[i] - b->vertices_smpl[i]));
    for (int k = 0; k < 9; k++) far = fmaxf(far, fabsf(a->R[k] - b->R[k]));
    for (int k = 0; k < 3; k++) far = fmaxf(far, fabsf(a->Th[k] - b->Th[k]));
    return far <= max;
}

sherf_status model_points_create(context *c, const model_config *config, const body_model *body,
                                 const posed_body *target, const ray_bundle *rays, int samples,
                                 const posed_body *observation, const sherf_camera *observation_camera,
                                 const occupancy_grid *empty, bool keep_stages, point_set **out) {
    /* in another pose only points near the body can be mapped to the observed pose */
    if (model_has_whole_box(config) &&
        (config->kind->one_pose || !observation || same_pose(body, target, observation)))
        return points_of_box(c, rays, samples, out);
    return points_create(c, body, target, rays, samples, observation, observation_camera, empty, keep_stages,
                         out);
}

/* `count` of the `from` numbers in list, distinct, to its front. */
static void draw_some(int32_t *list, int64_t from, int64_t count, uint64_t key) {
    for (int64_t i = 0; i < count; i++) {
        const int64_t j = i + random_below(key, (uint64_t)i, from - i);
        const int32_t drawn = list[j];
        list[j] = list[i];
        list[i] = drawn;
    }
}

/* Keeps only the drawn rays at the box: first rays in the mask, then others; all rays if there are too
 * few. */
static sherf_status rays_draw(context *c, ray_bundle *rays, const ray_draw *draw) {
    const int64_t n = (int64_t)rays->width * rays->height;
    int64_t inside = 0, outside = 0;
    int32_t *list = mem_alloc(c, (size_t)n, sizeof *list);
    if (!list) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < n; i++) /* from the front, and from the back */
        if (rays->at_box[i]) {
            if (draw->inside > 0 && draw->mask && draw->mask[i])
                list[inside++] = (int32_t)i;
            else
                list[n - 1 - outside++] = (int32_t)i;
        }
    memset(rays->at_box, 0, (size_t)n);
    const int64_t want = draw->count < inside + outside ? draw->count : inside + outside;
    int64_t from_inside = (int64_t)(draw->inside * (float)want + 0.5f);
    if (from_inside > inside) from_inside = inside;
    if (want - from_inside > outside) from_inside = want - outside;
    draw_some(list, inside, from_inside, draw->key);
    draw_some(list + n - outside, outside, want - from_inside, splitmix64(draw->key));
    for (int64_t i = 0; i < from_inside; i++) rays->at_box[list[i]] = 1;
    for (int64_t i = 0; i < want - from_inside; i++) rays->at_box[list[n - outside + i]] = 1;
    mem_free(list);
    return SHERF_OK;
}

/* Moving a ray's depths by part of a step keeps their spacing. */
static void rays_jitter(ray_bundle *rays, int samples, uint64_t key) {
    for (int64_t i = 0; i < (int64_t)rays->width * rays->height; i++) {
        const float step = samples > 1 ? (rays->far[i] - rays->near[i]) / (float)(samples - 1) : 0;
        const float by = step * (float)(random_uniform(key, (uint64_t)i) - 0.5);
        if (!rays->at_box[i] || rays->near[i] + by < 0) continue;
        rays->near[i] += by;
        rays->far[i] += by;
    }
}

static sherf_status target_make(context *c, const model_config *config, const body_model *body,
                                const sherf_camera *camera, const sherf_pose *pose,
                                const observation_geometry *observation, const ray_draw *draw,
                                bool keep_stages, target_geometry *g) {
    float min[3], max[3];
    sherf_status status =
        posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &g->body);
    if (status != SHERF_OK) return status;
    g->body->blend_m = (float)config->skin_blend_mm / 1000;
    body_world_box(body, g->body, min, max);
    status = rays_create(c, camera, min, max, &g->rays);
    if (status == SHERF_OK && draw && draw->count) status = rays_draw(c, g->rays, draw);
    if (status == SHERF_OK && draw && draw->jitter)
        rays_jitter(g->rays, config->samples, splitmix64(draw->key + 1));
    if (status == SHERF_OK)
        status = model_points_create(
            c, config, body, g->body, g->rays, config->samples, observation ? observation->body : NULL,
            observation ? &observation->camera : NULL, NULL, keep_stages, &g->points);
    if (status != SHERF_OK) return status;
    g->depth_min = INFINITY;
    g->depth_max = -INFINITY;
    for (int64_t i = 0; i < g->points->rays; i++) {
        g->depth_min = fminf(g->depth_min, g->rays->near[i]);
        g->depth_max = fmaxf(g->depth_max, g->rays->far[i]);
    }
    return SHERF_OK;
}

static sherf_status target_new(context *c, const model_config *config, const body_model *body,
                               const sherf_camera *camera, const sherf_pose *pose,
                               const observation_geometry *observation, const ray_draw *draw,
                               bool keep_stages, target_geometry **out) {
    *out = NULL;
    sherf_status status = camera_check(c, camera);
    if (status != SHERF_OK) return status;
    target_geometry *g = mem_zero(c, 1, sizeof *g);
    if (!g) return SHERF_NO_MEMORY;
    status = target_make(c, config, body, camera, pose, observation, draw, keep_stages, g);
    if (status == SHERF_OK)
        *out = g;
    else
        target_geometry_free(g);
    return status;
}

sherf_status target_geometry_create(context *c, const model_config *config, const body_model *body,
                                    const sherf_camera *camera, const sherf_pose *pose,
                                    const observation_geometry *observation, bool keep_stages,
                                    target_geometry **out) {
    return target_new(c, config, body, camera, pose, observation, NULL, keep_stages, out);
}

sherf_status target_geometry_draw(context *c, const model_config *config, const body_model *body,
                                  const sherf_camera *camera, const sherf_pose *pose,
                                  const observation_geometry *observation, const ray_draw *draw,
                                  target_geometry **out) {
    return target_new(c, config, body, camera, pose, observation, draw, false, out);
}

void target_geometry_free(target_geometry *g) {
    if (!g) return;
    posed_body_free(g->body);
    rays_free(g->rays);
    points_free(g->points);
    mem_free(g);
}
