/* The posed body as seen by a camera, compared with a mask and drawn over a picture. */
#include "data/silhouette.h"

#include <math.h>

/* The body's vertices and their raster; the caller frees both. */
static sherf_status raster_body(context *c, const body_model *body, const sherf_pose *pose,
                                const sherf_camera *camera, float **vertices, raster **out) {
    *out = NULL;
    posed_body *posed = NULL;
    *vertices = mem_alloc(c, (size_t)body->vertices * 3, sizeof **vertices);
    if (!*vertices) return SHERF_NO_MEMORY;
    sherf_status status =
        posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &posed);
    if (status) return status;
    body_vertices_world(body, posed, *vertices);
    posed_body_free(posed);
    return raster_create(c, camera, 1, body->vertices, *vertices, body->faces, body->face, out);
}

sherf_status silhouette_overlap(context *c, const sherf_observation *o, const body_model *body,
                                const sherf_pose *pose, const sherf_camera *camera, mask_reading reading,
                                double *overlap) {
    float *vertices;
    raster *r;
    *overlap = 0;
    sherf_status status = raster_body(c, body, pose, camera, &vertices, &r);
    if (!status) {
        size_t both = 0, either = 0;
        int width = o->image.width;
        for (int y = 0; y < o->image.height; y++)
            for (int x = 0; x < width; x++) {
                size_t at = (size_t)y * width + (reading == MASK_MIRRORED ? width - 1 - x : x);
                bool hit = r->face[(size_t)y * width + x] >= 0,
                     person = !o->mask[at] == (reading == MASK_INVERTED);
                if (o->unknown && o->unknown[at]) continue;
                both += hit && person;
                either += hit || person;
            }
        if (either) *overlap = (double)both / (double)either;
    }
    raster_free(r);
    mem_free(vertices);
    return status;
}

sherf_status silhouette_draw(context *c, const sherf_observation *o, const body_model *body,
                             const char *path) {
    static const float tint[3] = {0.45f, 0.75f, 1}, grey = 0.25f;
    const sherf_camera *camera = &o->camera;
    int width = o->image.width, height = o->image.height;
    float *vertices, *normals = NULL;
    uint8_t *rgb = NULL;
    raster *r;
    sherf_status status = raster_body(c, body, &o->pose, camera, &vertices, &r);
    if (status) goto done;
    status = SHERF_NO_MEMORY;
    normals = mem_alloc(c, (size_t)body->vertices * 3, sizeof *normals);
    rgb = mem_alloc(c, (size_t)width * height, 3);
    if (!normals || !rgb || (status = body_normals(c, body, vertices, normals))) goto done;
    for (size_t at = 0; at < (size_t)width * height; at++) {
        float color[3];
        bool known = o->mask[at] || (o->unknown && o->unknown[at]);
        for (int k = 0; k < 3; k++) color[k] = known ? o->image.data[at * 3 + k] : grey;
        if (r->face[at] >= 0) {
            const uint32_t *corner = body->face + 3 * (size_t)r->face[at];
            float toward = 0; /* the normal's part along the camera's axis: 1 faces the camera */
            for (int i = 0; i < 3; i++)
                for (int k = 0; k < 3; k++)
                    toward -=
                        r->barycentric[at * 3 + i] * normals[3 * (size_t)corner[i] + k] * camera->R[6 + k];
            float shade = 0.25f + 0.75f * fabsf(toward);
            for (int k = 0; k < 3; k++) color[k] = 0.45f * color[k] + 0.55f * shade * tint[k];
        }
        for (int k = 0; k < 3; k++) rgb[at * 3 + k] = float_to_u8(color[k]);
    }
    status = png_write(c, path, width, height, 3, rgb);
done:
    raster_free(r);
    mem_free(vertices);
    mem_free(normals);
    mem_free(rgb);
    return status;
}
