/* Frames for people to look at: the network's, with detail unless it is switched off. */
#include <math.h>

#include "avatar/detail.h"

/* Frames made on a GPU get their detail on the host, which poses the body again for it. */
sherf_status avatar_give_detail(context *c, const sherf_avatar *a, const body_model *body,
                                const posed_body *posed, const sherf_camera *camera,
                                const float background[3], sherf_frame *frame) {
    const avatar_detail *detail;
    const joint_pose *j = posed->joints;
    posed_body *whole = NULL;
    sherf_status status = avatar_detail_of(c, a, body, &detail);
    if (status == SHERF_OK && j) {
        status = posed_body_create(c, body, j->pose_rad, j->shape, posed->R, posed->Th, &whole);
        if (status == SHERF_OK) whole->blend_m = posed->blend_m;
        if (status == SHERF_OK) status = points_prepare(c, body, whole);
    }
    if (status == SHERF_OK)
        status = detail_apply(c, detail, body, j ? whole : posed, camera, background, frame);
    posed_body_free(whole);
    return status;
}

sherf_status avatar_render(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame) {
    static const sherf_render_options plain = {{0, 0, 0}, 0, 0, 0};
    const sherf_render_options *o = options ? options : &plain;
    sherf_status status = avatar_frame(c, a, body, posed, camera, o, frame);
    if (status == SHERF_OK && o->detail != SHERF_DETAIL_OFF)
        status = avatar_give_detail(c, a, body, posed, camera, o->background, frame);
    return status;
}

sherf_status sherf_render(sherf_context *c, const sherf_avatar *a, const sherf_body *body,
                          const sherf_pose *pose, const sherf_camera *camera,
                          const sherf_render_options *options, sherf_frame *frame) {
    posed_body *posed = NULL;
    if (a->form) return a->form->render(c, a, body, pose, camera, options, frame);
    sherf_status status = avatar_pose(c, a, body, pose, &posed);
    if (status == SHERF_OK) status = avatar_render(c, a, body, posed, camera, options, frame);
    posed_body_free(posed);
    return status;
}

/* Colour over black is colour times opacity. */
sherf_status sherf_frame_rgba(sherf_context *c, const sherf_frame *frame, sherf_image *out) {
    const sherf_image *color = &frame->color;
    size_t pixels = (size_t)color->width * (size_t)color->height;
    if (!out->data || out->width != color->width || out->height != color->height || out->channels != 4) {
        sherf_image_free(out);
        float *data = mem_alloc(c, pixels, 4 * sizeof *data);
        if (!data) return SHERF_NO_MEMORY;
        *out = (sherf_image){color->width, color->height, 4, data};
    }
    for (size_t i = 0; i < pixels; i++) {
        float a = fminf(fmaxf(frame->opacity.data[i], 0), 1);
        for (size_t k = 0; k < 3; k++)
            out->data[4 * i + k] = a > 1e-4f ? fminf(color->data[3 * i + k] / a, 1) : 0;
        out->data[4 * i + 3] = a;
    }
    return SHERF_OK;
}
