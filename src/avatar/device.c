/* The field that answers queries for an avatar, in the context that the avatar was made or loaded in. */
#include <math.h>

#include "avatar/avatar.h"

sherf_status avatar_place(context *c, const body_model *body, sherf_avatar *a) {
    const field_source source = {&a->config, a->weights, &a->kept, &a->sheet, a->pictures, a->picture};
    const model_kind *kind = a->config.kind;
    const field_kind *own = kind->field ? kind->field(&a->config) : NULL;
    a->field_kind = own ? own : &field_of_ops;
    return a->field_kind->create(c, &source, body, &a->field);
}

sherf_status avatar_query(context *c, const sherf_avatar *a, const body_model *body, const point_set *points,
                          float *rgb, float *sigma) {
    return a->field_kind->run(c, a->field, body, points, rgb, sigma);
}

sherf_status avatar_composite(context *c, const sherf_avatar *a, const body_model *body,
                              const ray_bundle *rays, const point_set *points, const float background[3],
                              bool early_stop, sherf_frame *frame) {
    return a->field_kind->render(c, a->field, body, rays, points, background, early_stop, frame);
}

bool avatar_takes_joints(const sherf_avatar *a) {
    return a->field_kind->takes_joints && a->field_kind->takes_joints(a->field);
}

/* How far equal poses may differ after they went through files. */
static bool same_pose(const sherf_pose *a, const sherf_pose *b) {
    const float max = 1e-4f;
    float far = 0;
    for (int i = 0; i < 72; i++) far = fmaxf(far, fabsf(a->poses_rad[i] - b->poses_rad[i]));
    for (int i = 0; i < 10; i++) far = fmaxf(far, fabsf(a->shapes[i] - b->shapes[i]));
    for (int i = 0; i < 9; i++) far = fmaxf(far, fabsf(a->R[i] - b->R[i]));
    for (int i = 0; i < 3; i++) far = fmaxf(far, fabsf(a->Th_m[i] - b->Th_m[i]));
    return far <= max;
}

sherf_status avatar_pose(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                         posed_body **out) {
    *out = NULL;
    sherf_status status = avatar_check_body(c, a, body);
    if (status != SHERF_OK) return status;
    if (a->config.kind->one_pose && !same_pose(&a->picture[0].pose, pose))
        return model_needs_canonical(c, &a->config);
    const bool joints = avatar_takes_joints(a);
    status = joints ? posed_joints_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, out)
                    : posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, out);
    if (status == SHERF_OK) (*out)->blend_m = (float)a->config.skin_blend_mm / 1000;
    if (status == SHERF_OK && !joints) status = points_prepare(c, body, *out);
    if (status == SHERF_OK) return SHERF_OK;
    posed_body_free(*out);
    *out = NULL;
    return status;
}
