/* One picture of a person: its requirements, and observations from memory. */
#include <math.h>

#include "data/view.h"

void sherf_observation_free(sherf_observation *o) {
    if (!o) return;
    sherf_image_free(&o->image);
    sherf_image_free(&o->fine);
    mem_free(o->mask);
    mem_free(o->unknown);
    mem_free(o);
}

const sherf_camera *sherf_observation_camera(const sherf_observation *o) {
    return &o->camera;
}
const sherf_pose *sherf_observation_pose(const sherf_observation *o) {
    return &o->pose;
}
const sherf_image *sherf_observation_image(const sherf_observation *o) {
    return &o->image;
}

static sherf_status pose_check(context *c, const sherf_pose *pose) {
    for (int i = 0; i < 72; i++)
        if (!isfinite(pose->poses_rad[i]))
            return failure(c, SHERF_BAD_ARGUMENT, "pose: value %d is not finite", i);
    for (int i = 0; i < 10; i++)
        if (!isfinite(pose->shapes[i]))
            return failure(c, SHERF_BAD_ARGUMENT, "shape: value %d is not finite", i);
    for (int i = 0; i < 3; i++)
        if (!isfinite(pose->Th_m[i])) return failure(c, SHERF_BAD_ARGUMENT, "Th: value %d is not finite", i);
    return rotation_check(c, pose->R, "the body's R");
}

sherf_status observation_check_shares(context *c, size_t person, size_t uncertain, size_t total) {
    if (!person) return failure(c, SHERF_BAD_ARGUMENT, "the mask is empty: no pixel is the person's");
    if (person + uncertain < total) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT,
                   "the mask covers the whole picture: it should be 0 outside the person");
}

sherf_status observation_check_mask(context *c, const sherf_observation *o) {
    const size_t n = (size_t)o->image.width * o->image.height;
    size_t person = 0, unknown = 0;
    for (size_t i = 0; i < n; i++) person += o->mask[i] != 0;
    for (size_t i = 0; o->unknown && i < n; i++) unknown += o->unknown[i] != 0;
    return observation_check_shares(c, person, unknown, n);
}

sherf_status observation_check(context *c, const sherf_observation *o) {
    sherf_status status = camera_check(c, &o->camera);
    if (!status) status = pose_check(c, &o->pose);
    if (status) return status;
    if (o->image.width != o->camera.width_px || o->image.height != o->camera.height_px ||
        o->image.channels != 3)
        return failure(c, SHERF_MISMATCH, "a picture of %d x %d x %d for a camera of %d x %d pixels",
                       o->image.width, o->image.height, o->image.channels, o->camera.width_px,
                       o->camera.height_px);
    if ((status = observation_check_mask(c, o))) return status;
    for (size_t i = 0; i < (size_t)o->image.width * o->image.height * 3; i++)
        if (!isfinite(o->image.data[i]))
            return failure(c, SHERF_BAD_ARGUMENT, "the picture has a value that is not finite");
    return SHERF_OK;
}

sherf_status observation_check_body(context *c, const sherf_observation *o, const body_model *body) {
    posed_body *posed = NULL;
    const sherf_pose *pose = &o->pose;
    sherf_status status =
        posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &posed);
    if (!status) status = body_in_picture(c, body, posed, &o->camera, o->mask);
    posed_body_free(posed);
    return status;
}

void observation_limit_size(context *c, const char *what, int *width, int *height) {
    const int longest = *width > *height ? *width : *height, had_width = *width, had_height = *height;
    if (longest <= VIEW_OBSERVED_SIDE_MAX) return;
    *width = (int)((int64_t)*width * VIEW_OBSERVED_SIDE_MAX / longest);
    *height = (int)((int64_t)*height * VIEW_OBSERVED_SIDE_MAX / longest);
    if (*width < 1) *width = 1;
    if (*height < 1) *height = 1;
    log_line(c, SHERF_LOG_INFO, "%s: %d x %d pixels, scaled to %d x %d", what, had_width, had_height, *width,
             *height);
}

sherf_status observation_resize(context *c, sherf_observation *o, int width, int height) {
    image_u8 mask = {o->image.width, o->image.height, 1, o->mask};
    if (width == mask.width && height == mask.height) return SHERF_OK;
    sherf_status status = image_resize_area(c, &o->image, width, height);
    if (status == SHERF_OK) status = image_resize_nearest(c, &mask, width, height);
    o->mask = mask.data;
    if (status != SHERF_OK) return status;
    camera_resize(&o->camera, width, height);
    return observation_check(c, o);
}

/* Scales to the working size, like pictures from files. */
static sherf_status shrink(context *c, sherf_observation *o) {
    int width = o->image.width, height = o->image.height;
    observation_limit_size(c, "observation", &width, &height);
    return observation_resize(c, o, width, height);
}

sherf_status sherf_observation_create(sherf_context *c, const sherf_image *image, const sherf_image *mask,
                                      const sherf_camera *camera, const sherf_pose *pose,
                                      sherf_observation **out) {
    *out = NULL;
    if (!image->data || !mask->data || image->width < 1 || image->height < 1 || image->channels != 3 ||
        mask->channels != 1 || mask->width != image->width || mask->height != image->height)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "a picture of %d x %d x %d and a mask of %d x %d x %d, expected 3 and 1 channels of "
                       "one size",
                       image->width, image->height, image->channels, mask->width, mask->height,
                       mask->channels);
    if (image->width > VIEW_READ_SIDE_MAX || image->height > VIEW_READ_SIDE_MAX)
        return failure(c, SHERF_UNSUPPORTED,
                       "%d x %d pixels, at most %d on a side: scale the picture (and K) down", image->width,
                       image->height, VIEW_READ_SIDE_MAX);
    size_t n = (size_t)image->width * image->height;
    sherf_status status = SHERF_NO_MEMORY;
    sherf_observation *o = mem_zero(c, 1, sizeof *o);
    if (!o) return status;
    o->image = (sherf_image){image->width, image->height, 3, mem_alloc(c, n * 3, sizeof(float))};
    o->mask = mem_alloc(c, n, 1);
    o->camera = *camera;
    o->pose = *pose;
    if (!o->image.data || !o->mask) goto fail;
    for (size_t i = 0; i < n; i++) {
        o->mask[i] = mask->data[i] != 0;
        for (int k = 0; k < 3; k++) o->image.data[i * 3 + k] = o->mask[i] ? image->data[i * 3 + k] : 0;
    }
    if ((status = observation_check(c, o)) || (status = shrink(c, o))) goto fail;
    *out = o;
    return SHERF_OK;
fail:
    sherf_observation_free(o);
    return status;
}
