/* One draw as a picture: observation, target, prediction. */
#include <string.h>

#include "train/picture.h"

/* `image` at column `left` of a canvas `stride` pixels wide. */
static void place(uint8_t *canvas, size_t stride, size_t left, const sherf_image *image) {
    const size_t width = 3 * (size_t)image->width;
    for (size_t y = 0; y < (size_t)image->height; y++)
        for (size_t x = 0; x < width; x++)
            canvas[3 * (y * stride + left) + x] = float_to_u8(image->data[y * width + x]);
}

sherf_status picture_write(context *c, const sherf_dataset *d, const model *m, const body_model *body,
                           draw drawn, int width, const char *path) {
    /* exact: with one frame per avatar an occupancy grid does not pay */
    const sherf_render_options model_steps = {
        .samples = SHERF_SAMPLES_MODEL, .exact = 1, .detail = SHERF_DETAIL_OFF};
    data_view *observation = NULL, *target = NULL;
    sherf_avatar *avatar = NULL;
    sherf_frame frame = {0};
    uint8_t *canvas = NULL;
    sherf_status status =
        dataset_person_view(c, d, drawn.person, drawn.pose, drawn.observed_view, width, &observation);
    if (status == SHERF_OK)
        status = dataset_person_view(c, d, drawn.person, drawn.pose, drawn.view, width, &target);
    if (status == SHERF_OK) status = sherf_avatar_create(c, m, body, observation, &avatar);
    if (status == SHERF_OK)
        status = sherf_render(c, avatar, body, &target->pose, &target->camera, &model_steps, &frame);
    if (status != SHERF_OK) goto done;
    const sherf_image *part[3] = {&observation->image, &target->image, &frame.color};
    size_t stride = 0, height = 0, left = 0;
    for (int i = 0; i < 3; i++) {
        stride += (size_t)part[i]->width;
        if ((size_t)part[i]->height > height) height = (size_t)part[i]->height;
    }
    if (!(canvas = mem_zero(c, stride * height, 3))) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    for (int i = 0; i < 3; left += (size_t)part[i]->width, i++) place(canvas, stride, left, part[i]);
    status = png_write(c, path, (int)stride, (int)height, 3, canvas);
done:
    mem_free(canvas);
    sherf_frame_free(&frame);
    sherf_avatar_free(avatar);
    sherf_observation_free(target);
    sherf_observation_free(observation);
    return status;
}
