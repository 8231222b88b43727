/* What the body and the cameras decide, before any weight is touched. */
#include <math.h>
#include <string.h>

#include "model/model.h"

sherf_status observation_geometry_create(context *c, const model_config *config, const body_model *body,
                                         const sherf_image *image_rgb, const sherf_camera *camera,
                                         const sherf_pose *pose, bool training, observation_geometry **out) {
    *out = NULL;
    sherf_status status = camera_check(c, camera);
    if (status != SHERF_OK) return status;
    if (image_rgb->channels != 3 || image_rgb->width != camera->width_px ||
        image_rgb->height != camera->height_px)
        return failure(c, SHERF_MISMATCH, "the picture is %d x %d x %d, the camera's is %d x %d x 3",
                       image_rgb->width, image_rgb->height, image_rgb->channels, camera->width_px,
                       camera->height_px);
    if (image_rgb->width < 32 || image_rgb->height < 32)
        return failure(c, SHERF_BAD_ARGUMENT, "the picture is %d x %d: at least 32 x 32 are needed",
                       image_rgb->width, image_rgb->height);
    observation_geometry *g = mem_zero(c, 1, sizeof *g);
    if (!g) return SHERF_NO_MEMORY;
    g->kind = config->kind;
    g->width = image_rgb->width;
    g->height = image_rgb->height;
    g->camera = *camera;
    g->vertices = body->vertices;
    const size_t N = (size_t)g->width * (size_t)g->height * 3;
    g->image = mem_alloc(c, N, sizeof(float));
    if (!g->image) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    memcpy(g->image, image_rgb->data, N * sizeof(float));
    status = posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &g->body);
    if (status != SHERF_OK) goto done;
    g->body->blend_m = (float)config->skin_blend_mm / 1000;
    if (config->kind->observe) status = config->kind->observe(c, config, body, training, g);
done:
    if (status == SHERF_OK)
        *out = g;
    else
        observation_geometry_free(g);
    return status;
}

void observation_geometry_free(observation_geometry *g) {
    if (!g) return;
    mem_free(g->image);
    posed_body_free(g->body);
    if (g->kind->observed_free) g->kind->observed_free(g->own);
    mem_free(g);
}

sherf_status target_geometry_create(context *c, const model_config *config, const body_model *body,
                                    const sherf_camera *camera, const sherf_pose *pose,
                                    const observation_geometry *observation, bool keep_stages,
                                    target_geometry **out) {
    *out = NULL;
    sherf_status status = camera_check(c, camera);
    if (status != SHERF_OK) return status;
    target_geometry *g = mem_zero(c, 1, sizeof *g);
    if (!g) return SHERF_NO_MEMORY;
    float min[3], max[3];
    status = posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &g->body);
    if (status != SHERF_OK) goto done;
    g->body->blend_m = (float)config->skin_blend_mm / 1000;
    body_world_box(body, g->body, min, max);
    status = rays_create(c, camera, min, max, &g->rays);
    if (status != SHERF_OK) goto done;
    status = points_create(c, body, g->body, g->rays, config->samples, observation ? observation->body : NULL,
                           observation ? &observation->camera : NULL, NULL, keep_stages, &g->points);
    if (status != SHERF_OK) goto done;
    g->depth_min = INFINITY;
    g->depth_max = -INFINITY;
    for (int64_t i = 0; i < g->points->rays; i++) {
        g->depth_min = fminf(g->depth_min, g->rays->near[i]);
        g->depth_max = fmaxf(g->depth_max, g->rays->far[i]);
    }
done:
    if (status == SHERF_OK)
        *out = g;
    else
        target_geometry_free(g);
    return status;
}

void target_geometry_free(target_geometry *g) {
    if (!g) return;
    posed_body_free(g->body);
    rays_free(g->rays);
    points_free(g->points);
    mem_free(g);
}
