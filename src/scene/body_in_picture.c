/* A body in front of a camera: checks, before anything is computed, that both belong together, and measures
 * the body's size in the picture. */
#include <math.h>

#include "scene/scene.h"

/* Pixels; a smaller person is not visible. */
enum { SIDE_MIN = 2 };

sherf_status body_in_picture(context *c, const body_model *body, const posed_body *p,
                             const sherf_camera *camera, const uint8_t *mask) {
    size_t V = (size_t)body->vertices, inside = 0, masked = 0;
    float min[2] = {INFINITY, INFINITY}, max[2] = {-INFINITY, -INFINITY};
    float *vertices = mem_alloc(c, V * 3, sizeof *vertices);
    float *uv = mem_alloc(c, V * 2, sizeof *uv), *depth = mem_alloc(c, V, sizeof *depth);
    sherf_status status = vertices && uv && depth ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        body_vertices_world(body, p, vertices);
        camera_project(camera, (int64_t)V, vertices, uv, depth);
        for (size_t i = 0; i < V; i++) {
            float x = uv[2 * i], y = uv[2 * i + 1];
            if (!(depth[i] > 0 && x >= 0 && x < camera->width_px && y >= 0 && y < camera->height_px))
                continue;
            inside++;
            for (int k = 0; k < 2; k++) {
                min[k] = fminf(min[k], uv[2 * i + (size_t)k]);
                max[k] = fmaxf(max[k], uv[2 * i + (size_t)k]);
            }
            masked += mask && mask[(size_t)y * (size_t)camera->width_px + (size_t)x];
        }
        if (!inside)
            status = failure(c, SHERF_MISMATCH,
                             "the body lies outside the picture: camera and body do not belong together "
                             "(metres? world to camera? see sherf check)");
        else if (inside == V && max[0] - min[0] < SIDE_MIN && max[1] - min[1] < SIDE_MIN)
            status = failure(c, SHERF_MISMATCH,
                             "the body would be less than %d pixels large: camera and body do not belong "
                             "together (metres? see sherf check)",
                             SIDE_MIN);
        else if (mask && !masked)
            status = failure(c, SHERF_MISMATCH,
                             "no part of the body lies inside the mask: mask, camera and body do not belong "
                             "together (see sherf check)");
    }
    mem_free(vertices);
    mem_free(uv);
    mem_free(depth);
    return status;
}

sherf_status body_joints_camera(context *c, const body_model *body, const sherf_pose *pose,
                                const sherf_camera *camera, float out[BODY_JOINTS][3]) {
    float world[BODY_JOINTS][3];
    sherf_status status = sherf_body_pose(c, body, pose, NULL, world[0]);
    if (status != SHERF_OK) return status;
    for (int j = 0; j < BODY_JOINTS; j++)
        for (int i = 0; i < 3; i++) {
            const float *r = camera->R + 3 * i;
            out[j][i] = r[0] * world[j][0] + r[1] * world[j][1] + r[2] * world[j][2] + camera->T_m[i];
        }
    return SHERF_OK;
}

sherf_status body_px_per_m(context *c, const body_model *body, const sherf_pose *pose,
                           const sherf_camera *camera, double *out) {
    float joint[BODY_JOINTS][3];
    double z = 0;
    *out = 0;
    sherf_status status = body_joints_camera(c, body, pose, camera, joint);
    if (status != SHERF_OK) return status;
    for (int j = 0; j < BODY_JOINTS; j++) z += (double)joint[j][2] / BODY_JOINTS;
    if (z > 1e-3) *out = sqrt((double)camera->K[0] * (double)camera->K[4]) / z;
    return SHERF_OK;
}
