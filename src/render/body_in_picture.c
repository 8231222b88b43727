/* Camera and body that do not belong together are told before anything is computed from them. */
#include "render/render.h"

sherf_status body_in_picture(context *c, const body_model *m, const posed_body *p,
                             const sherf_camera *camera) {
    size_t V = (size_t)m->vertices, inside = 0;
    float *vertices = mem_alloc(c, V * 3, sizeof *vertices);
    float *uv = mem_alloc(c, V * 2, sizeof *uv), *depth = mem_alloc(c, V, sizeof *depth);
    sherf_status status = vertices && uv && depth ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        body_vertices_world(m, p, vertices);
        camera_project(camera, (int64_t)V, vertices, uv, depth);
        for (size_t i = 0; i < V; i++)
            inside += depth[i] > 0 && uv[2 * i] >= 0 && uv[2 * i] < camera->width_px && uv[2 * i + 1] >= 0 &&
                      uv[2 * i + 1] < camera->height_px;
        if (!inside)
            status = failure(c, SHERF_MISMATCH,
                             "the body lies outside the picture: camera and body do not belong together "
                             "(metres? world to camera? see sherf check)");
    }
    mem_free(vertices);
    mem_free(uv);
    mem_free(depth);
    return status;
}
