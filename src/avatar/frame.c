/* Frames from the network: the number of depths on its rays, and the points that are skipped. */
#include <math.h>
#include <string.h>

#include "avatar/avatar.h"
#include "sampling/tiles.h"
#include "scene/ray.h"

/* Density is per metre, so opacity does not depend on the step length, but long steps miss what lies between
 * two depths. The model was trained with steps of 8 to 15 mm for upright people. */
enum { SAMPLES_MAX = 1024 };
static const float step_max_m = 0.012f;

/* The rays of a frame and their number of depths; *extent: before the depths that are added past the box. */
static sherf_status frame_rays(context *c, const sherf_avatar *a, const body_model *body,
                               const posed_body *posed, const sherf_camera *camera, int requested,
                               ray_bundle **rays, int *samples, ray_extent *extent) {
    float min[3], max[3];
    body_world_box(body, posed, min, max);
    sherf_status status = rays_create(c, camera, min, max, rays);
    if (status != SHERF_OK) return status;
    if (requested != SHERF_SAMPLES_MODEL) rays_repair(c, *rays, min, max);
    *extent = rays_extent(c, *rays);
    *samples = requested > 0 ? requested : a->config.samples;
    const bool box = model_has_whole_box(&a->config); /* whose field is not empty past the box */
    if (!box && (!requested || requested == SHERF_SAMPLES_AUTO))
        *samples = rays_even_steps(c, *rays, extent->longest_m, *samples, SAMPLES_MAX, step_max_m);
    return SHERF_OK;
}

static sherf_status frame_gpu(context *c, const sherf_avatar *a, const posed_body *posed,
                              const sherf_camera *camera, const sherf_render_options *o,
                              const occupancy_grid *empty, sherf_frame *frame) {
    const bool even = !o->samples || o->samples == SHERF_SAMPLES_AUTO;
    gpu_frame_options on_gpu = {.samples = o->samples > 0 ? o->samples : a->config.samples,
                                .samples_max = even ? SAMPLES_MAX : 0,
                                .step_max_m = step_max_m,
                                .repair = o->samples != SHERF_SAMPLES_MODEL,
                                .early_stop = !o->exact,
                                .empty = empty};
    memcpy(on_gpu.background, o->background, sizeof on_gpu.background);
    if (!posed->joints)
        return failure(c, SHERF_MISMATCH, "the avatar is on a GPU, and the pose was made for the processor");
    return a->field_kind->render_joints(c, a->field, posed, camera, &on_gpu, frame);
}

/* Uses the network for samples of large weight, the coarse field for the others. */
static sherf_status frame_coarse(context *c, const sherf_avatar *a, const body_model *body,
                                 const posed_body *posed, const ray_bundle *rays, int samples, float pitch_m,
                                 const coarse_field *coarse, const float background[3], sherf_frame *frame) {
    coarse_points points;
    float *rgb = NULL, *sigma = NULL;
    sherf_status status = coarse_points_create(c, body, posed, rays, samples, pitch_m, a->sheet.body,
                                               &a->sheet.camera, coarse, &points);
    if (status != SHERF_OK) goto done;
    const size_t queried = (size_t)points.queried->count;
    rgb = mem_alloc(c, queried, 3 * sizeof *rgb);
    sigma = mem_alloc(c, queried, sizeof *sigma);
    status = rgb && sigma ? avatar_query(c, a, body, points.queried, rgb, sigma) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = coarse_points_answer(c, rays, rgb, sigma, &points);
    if (status == SHERF_OK)
        status = points_render(c, rays, &points.all, points.rgb, points.sigma, background, frame);
    if (status == SHERF_OK) frame->points = points.queried->count;
done:
    mem_free(rgb);
    mem_free(sigma);
    coarse_points_free(&points);
    return status;
}

static sherf_status frame_of_points(context *c, const sherf_avatar *a, const body_model *body,
                                    const posed_body *posed, const ray_bundle *rays, int samples,
                                    const occupancy_grid *empty, const sherf_render_options *o,
                                    sherf_frame *frame) {
    point_set *points = NULL;
    if (a->field_kind->surface)
        return avatar_composite(c, a, body, rays, NULL, o->background, !o->exact, frame);
    sherf_status status = model_points_create(c, &a->config, body, posed, rays, samples, a->sheet.body,
                                              &a->sheet.camera, empty, false, &points);
    if (status == SHERF_OK)
        status = avatar_composite(c, a, body, rays, points, o->background, !o->exact, frame);
    if (status == SHERF_OK) frame->points = points->count;
    points_free(points);
    return status;
}

sherf_status avatar_frame(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                          const sherf_camera *camera, const sherf_render_options *o, sherf_frame *frame) {
    const occupancy_grid *empty = NULL;
    const coarse_field *coarse = NULL;
    ray_bundle *rays = NULL;
    ray_extent extent;
    int samples;
    if (o->samples < SHERF_SAMPLES_MODEL || o->samples > SAMPLES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "samples %d: must be 1 to %d, or 0 for automatic", o->samples,
                       SAMPLES_MAX);
    sherf_status status = camera_check(c, camera);
    const bool looks = !o->exact && !a->config.kind->one_pose && !model_has_whole_box(&a->config);
    if (status == SHERF_OK && looks) status = avatar_occupancy(c, a, body, &empty, &coarse);
    if (status == SHERF_OK && avatar_takes_joints(a)) return frame_gpu(c, a, posed, camera, o, empty, frame);
    if (status == SHERF_OK)
        status = frame_rays(c, a, body, posed, camera, o->samples, &rays, &samples, &extent);
    if (status != SHERF_OK) return status;
    /* a small picture has few more points than the field has cells */
    const float pitch_m = rays_pitch(rays, extent.nearest);
    if (coarse && !(pitch_m * coarse->per_m < 1)) coarse = NULL;
    status = coarse ? frame_coarse(c, a, body, posed, rays, samples, pitch_m, coarse, o->background, frame)
                    : frame_of_points(c, a, body, posed, rays, samples, empty, o, frame);
    for (size_t i = 0; status == SHERF_OK && i < (size_t)rays->width * (size_t)rays->height; i++)
        if (frame->depth.data[i] > extent.farthest) frame->depth.data[i] = extent.farthest;
    rays_free(rays);
    return status;
}
