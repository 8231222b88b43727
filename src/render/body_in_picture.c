/* Camera and body that do not belong together are told before anything is computed from them. */
#include "render/render.h"

sherf_status body_in_picture(context *c, const body_model *m, const posed_body *p, const sherf_camera *camera,
                             const uint8_t *mask) {
    size_t V = (size_t)m->vertices, inside = 0, masked = 0;
    float *vertices = mem_alloc(c, V * 3, sizeof *vertices);
    float *uv = mem_alloc(c, V * 2, sizeof *uv), *depth = mem_alloc(c, V, sizeof *depth);
    sherf_status status = vertices && uv && depth ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        body_vertices_world(m, p, vertices);
        camera_project(camera, (int64_t)V, vertices, uv, depth);
        for (size_t i = 0; i < V; i++) {
            float x = uv[2 * i], y = uv[2 * i + 1];
            if (!(depth[i] > 0 && x >= 0 && x < camera->width_px && y >= 0 && y < camera->height_px))
                continue;
            inside++;
            masked += mask && mask[(size_t)y * (size_t)camera->width_px + (size_t)x];
        }
        if (!inside)
            status = failure(c, SHERF_MISMATCH,
                             "the body lies outside the picture: camera and body do not belong together "
                             "(metres? world to camera? see sherf check)");
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
