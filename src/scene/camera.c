/* Pinhole cameras with OpenCV axes: projection, checks, orbit; the vertices that face a camera. */
#include <math.h>
#include <string.h>

#include "scene/ray.h"

enum { CAMERA_SIZE_MAX = 1 << 15 };

static double determinant(const float K[9]) {
    return K[0] * ((double)K[4] * K[8] - (double)K[5] * K[7]) -
           K[1] * ((double)K[3] * K[8] - (double)K[5] * K[6]) +
           K[2] * ((double)K[3] * K[7] - (double)K[4] * K[6]);
}

sherf_status camera_check(context *c, const sherf_camera *camera) {
    if (camera->width_px < 1 || camera->width_px > CAMERA_SIZE_MAX || camera->height_px < 1 ||
        camera->height_px > CAMERA_SIZE_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "camera: size %d x %d, sides must be 1 to %d pixels",
                       camera->width_px, camera->height_px, CAMERA_SIZE_MAX);
    for (int i = 0; i < 9; i++) {
        if (!isfinite(camera->K[i])) return failure(c, SHERF_BAD_ARGUMENT, "camera: K is not finite");
        if (!isfinite(camera->R[i])) return failure(c, SHERF_BAD_ARGUMENT, "camera: R is not finite");
        if (!isfinite(camera->T_m[i / 3])) return failure(c, SHERF_BAD_ARGUMENT, "camera: T is not finite");
    }
    if (!rotation_is_valid(camera->R))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "camera: R is not a rotation (rows of length 1 at right angles)");
    double det = determinant(camera->K), size = 0;
    for (int i = 0; i < 9; i++) size = fmax(size, fabs(camera->K[i]));
    if (!(fabs(det) > 1e-9 * size * size))
        return failure(c, SHERF_BAD_ARGUMENT, "camera: K is singular (determinant %g)", det);
    if (fabs(camera->K[6]) > 1e-6 || fabs(camera->K[7]) > 1e-6 || fabs(camera->K[8] - 1) > 1e-6)
        return failure(c, SHERF_BAD_ARGUMENT, "camera: the last row of K is %g %g %g, must be 0 0 1",
                       camera->K[6], camera->K[7], camera->K[8]);
    return SHERF_OK;
}

void camera_project(const sherf_camera *camera, int64_t n, const float *points_world, float *uv_px,
                    float *depth_m) {
    for (int64_t i = 0; i < n; i++) {
        const float z = project_point(camera->K, camera->R, camera->T_m, points_world + 3 * i, uv_px + 2 * i);
        if (depth_m) depth_m[i] = z;
    }
}

void camera_position(const sherf_camera *camera, float position_world[3]) {
    const float *R = camera->R, *T = camera->T_m;
    for (int k = 0; k < 3; k++) position_world[k] = -(R[k] * T[0] + R[3 + k] * T[1] + R[6 + k] * T[2]);
}

void camera_resize(sherf_camera *camera, int width_px, int height_px) {
    float x = (float)width_px / (float)camera->width_px, y = (float)height_px / (float)camera->height_px;
    for (int k = 0; k < 3; k++) {
        camera->K[k] *= x;
        camera->K[3 + k] *= y;
    }
    camera->width_px = width_px;
    camera->height_px = height_px;
}

void sherf_camera_orbit(const float centre_m[3], float distance_m, float azimuth_rad, float elevation_rad,
                        float fov_rad, int width_px, int height_px, sherf_camera *out) {
    double ca = cos(azimuth_rad), sa = sin(azimuth_rad), ce = cos(elevation_rad), se = sin(elevation_rad);
    /* rows: right, down, forward; the camera is at centre - distance * forward */
    double R[9] = {ca, 0, -sa, sa * se, -ce, ca * se, -sa * ce, -se, -ca * ce};
    double focal = 0.5 * height_px / tan(0.5 * fov_rad);
    *out = (sherf_camera){.width_px = width_px, .height_px = height_px};
    out->K[0] = out->K[4] = (float)focal;
    out->K[2] = 0.5f * (float)width_px;
    out->K[5] = 0.5f * (float)height_px;
    out->K[8] = 1;
    for (int r = 0; r < 3; r++) {
        double sum = 0; /* T = -R position = distance * (0, 0, 1) - R centre */
        for (int k = 0; k < 3; k++) {
            out->R[3 * r + k] = (float)R[3 * r + k];
            sum += R[3 * r + k] * centre_m[k];
        }
        out->T_m[r] = (float)((r == 2 ? distance_m : 0) - sum);
    }
}

sherf_status vertices_visible(context *c, const body_model *body, const float *vertices_world,
                              const sherf_camera *camera, int32_t *visible) {
    float *normals = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *normals);
    if (!normals) return SHERF_NO_MEMORY;
    sherf_status status = body_normals(c, body, vertices_world, normals);
    for (int v = 0; v < body->vertices && status == SHERF_OK; v++) {
        const float *x = vertices_world + 3 * (size_t)v, *n = normals + 3 * (size_t)v;
        float dot = 0;
        for (int r = 0; r < 3; r++) {
            const float *R = camera->R + 3 * r;
            dot += (R[0] * n[0] + R[1] * n[1] + R[2] * n[2]) *
                   (R[0] * x[0] + R[1] * x[1] + R[2] * x[2] + camera->T_m[r]);
        }
        visible[v] = dot < 0;
    }
    mem_free(normals);
    return status;
}
