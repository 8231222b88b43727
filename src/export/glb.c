/* GLB: a baked person as binary glTF, with one vertex for each corner of the atlas. */
#include <string.h>

#include "export/export.h"
#include "export/gltf.h"
#include "io/image.h"

/* The vertices of a .glb: one for each corner of the atlas, or the surface's own. */
typedef struct {
    float *position, *normal, *uv, *weight;
    uint8_t *joint;
    unsigned char *png;
    sherf_pose *clip;
} glb_room;

static sherf_status glb_corners(context *c, const baked_person *p, glb_room *r) {
    const atlas *a = &p->atlas;
    const size_t n = (size_t)a->corners;
    r->position = mem_alloc(c, n, 3 * sizeof(float));
    r->normal = mem_alloc(c, n, 3 * sizeof(float));
    r->uv = mem_alloc(c, n, 2 * sizeof(float));
    r->joint = mem_alloc(c, n, 4);
    r->weight = mem_alloc(c, n, 4 * sizeof(float));
    if (!r->position || !r->normal || !r->uv || !r->joint || !r->weight) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        const size_t v = a->vertex[i];
        memcpy(r->position + 3 * i, p->surface.position + 3 * v, 3 * sizeof(float));
        memcpy(r->normal + 3 * i, p->surface.normal + 3 * v, 3 * sizeof(float));
        memcpy(r->joint + 4 * i, p->skin.joint + 4 * v, 4);
        memcpy(r->weight + 4 * i, p->skin.weight + 4 * v, 4 * sizeof(float));
        for (size_t k = 0; k < 2; k++) r->uv[2 * i + k] = (a->uv[2 * i + k] + 0.5f) / (float)a->side_px;
    }
    return SHERF_OK;
}

static sherf_status glb_write(context *c, const export_job *j) {
    const baked_person *p = j->person;
    const sherf_motion *motion = j->options->motion;
    glb_room r = {0};
    gltf_person g = {.vertices = p->surface.vertices,
                     .triangles = p->surface.triangles,
                     .position = p->surface.position,
                     .normal = p->surface.normal,
                     .rgb = p->rgb,
                     .joint = p->skin.joint,
                     .weight = p->skin.weight,
                     .triangle = p->surface.triangle,
                     .parent = j->body->parent,
                     .joints_rest = p->posed->joints_rest,
                     .pose = j->options->pose,
                     .lit = j->options->lit};
    sherf_status status = SHERF_OK;
    if (p->picture) {
        status = glb_corners(c, p, &r);
        if (status == SHERF_OK)
            status =
                png_to_memory(c, p->atlas.side_px, p->atlas.side_px, 3, p->picture, 6, &r.png, &g.png_bytes);
        g.vertices = p->atlas.corners;
        g.position = r.position;
        g.normal = r.normal;
        g.uv = r.uv;
        g.joint = r.joint;
        g.weight = r.weight;
        g.triangle = p->atlas.triangle;
        g.png = r.png;
    }
    if (status == SHERF_OK && motion) {
        g.frames = sherf_motion_frame_count(motion);
        g.fps = sherf_motion_fps(motion);
        g.clip = r.clip = mem_alloc(c, (size_t)g.frames, sizeof *r.clip);
        if (!r.clip) status = SHERF_NO_MEMORY;
        for (int f = 0; f < g.frames && r.clip; f++) sherf_motion_pose(motion, f, &r.clip[f]);
    }
    if (status == SHERF_OK) status = gltf_write(c, j->path, &g);
    mem_free(r.position);
    mem_free(r.normal);
    mem_free(r.uv);
    mem_free(r.joint);
    mem_free(r.weight);
    mem_free(r.png);
    mem_free(r.clip);
    return status;
}

const export_format export_glb = {
    .name = "glb", .ending = ".glb", .texture = true, .rigged = true, .write = glb_write};
