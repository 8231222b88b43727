/* What the body and the observation's camera determine for the point-level features (section 3.3): which
 * vertices are visible, the sparse volume's voxels and the rules of its convolutions (network.md 3). */
#include <math.h>
#include <string.h>

#include "model/sherf/sherf.h"

sherf_status model_sherf_volume_size(context *c, const model_config *config, const body_model *body,
                                     int size_zyx[3]) {
    float min[3], max[3];
    body_canonical_bounds(body, min, max);
    for (int a = 0; a < 3; a++) { /* a counts x y z */
        float cells = ceilf((max[a] - min[a]) / model_sherf_settings(config)->voxel_size_m);
        if (!(cells >= 1 && cells <= 2048))
            return failure(c, SHERF_BAD_ARGUMENT, "the canonical body is %g m wide: not a body in metres",
                           (double)(max[a] - min[a]));
        size_zyx[2 - a] = ((int)cells | 31) + 1;
    }
    return SHERF_OK;
}

/* Voxel of each vertex, the volume's sizes, the active voxels and rules of every level (network.md 3).
 * Inverse LBS takes the observation's vertices to canonical space, which puts them on the canonical body. */
static sherf_status volume_layout(context *c, const model_config *config, const body_model *body,
                                  const posed_body *observed, sherf_geometry *g, bool further,
                                  const int32_t *fixed_voxels) {
    float max[3];
    body_canonical_bounds(body, g->volume_min, max);
    g->voxel_size_m = model_sherf_settings(config)->voxel_size_m;
    sherf_status status = model_sherf_volume_size(c, config, body, g->volume_size);
    if (status != SHERF_OK) return status;
    g->levels = model_sherf_settings(config)->point_levels;
    for (int l = 0; l < g->levels + 2; l++)
        for (int a = 0; a < 3; a++) g->level[l].size[a] = g->volume_size[a] >> l;
    g->vertex_zyx = mem_alloc(c, (size_t)body->vertices * 3, sizeof(int32_t));
    g->vertex_voxel = mem_alloc(c, (size_t)body->vertices, sizeof(int32_t));
    float *canonical = mem_alloc(c, (size_t)body->vertices * 3, sizeof(float));
    status = g->vertex_zyx && g->vertex_voxel && canonical ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        deform_to_canonical(body, observed, body->vertices, observed->vertices_smpl, NULL, NULL, canonical,
                            NULL);
        for (int64_t i = 0; i < (int64_t)body->vertices * 3; i++) {
            int a = (int)(i % 3);
            float voxel = rintf((canonical[i] - g->volume_min[a]) / g->voxel_size_m);
            int limit = g->volume_size[2 - a] - 1;
            int at = voxel >= 0 ? voxel <= (float)limit ? (int)voxel : limit : 0;
            g->vertex_zyx[i - a + 2 - a] = at;
        }
        if (fixed_voxels) memcpy(g->vertex_zyx, fixed_voxels, (size_t)body->vertices * 3 * sizeof(int32_t));
        status = sparse_levels_create(c, g->level, g->levels + (further ? 2 : 1), g->levels + 1,
                                      body->vertices, g->vertex_zyx);
    }
    for (int v = 0; status == SHERF_OK && v < body->vertices; v++)
        g->vertex_voxel[v] = g->level[0].grid[sparse_voxel(g->level, g->vertex_zyx + 3 * (int64_t)v)];
    mem_free(canonical);
    return status;
}

sherf_geometry *model_sherf_geometry(const observation_geometry *g) {
    return g->own;
}

sherf_status model_sherf_observe_at(context *c, const model_config *config, const body_model *body,
                                    bool training, const int32_t *voxels, observation_geometry *observation) {
    const size_t V = (size_t)body->vertices;
    sherf_geometry *g = mem_zero(c, 1, sizeof *g);
    model_sherf_geometry_free(observation->own);
    observation->own = g;
    if (!g) return SHERF_NO_MEMORY;
    g->visible = mem_alloc(c, V, sizeof(int32_t));
    g->vertex_px = mem_alloc(c, V * 2, sizeof(float));
    float *world = mem_alloc(c, V * 3, sizeof(float));
    sherf_status status = g->visible && g->vertex_px && world ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        if (observation->body->read_from)
            deform_to_picture(body, observation->body, (int64_t)V, body->canonical->vertices_smpl, NULL,
                              world);
        else
            body_vertices_world(body, observation->body, world);
        camera_project(&observation->camera, (int64_t)V, world, g->vertex_px, NULL);
        if (observation->body->seen)
            memcpy(g->visible, observation->body->seen, V * sizeof *g->visible);
        else
            status = vertices_visible(c, body, world, &observation->camera, g->visible);
    }
    if (status == SHERF_OK) status = volume_layout(c, config, body, observation->body, g, training, voxels);
    mem_free(world);
    return status;
}

sherf_status model_sherf_observe(context *c, const model_config *config, const body_model *body,
                                 bool training, observation_geometry *g) {
    return model_sherf_observe_at(c, config, body, training, NULL, g);
}

void model_sherf_geometry_free(void *geometry) {
    sherf_geometry *g = geometry;
    if (!g) return;
    mem_free(g->visible);
    mem_free(g->vertex_px);
    mem_free(g->vertex_zyx);
    mem_free(g->vertex_voxel);
    sparse_levels_free(g->level, (int)COUNT_OF(g->level));
    mem_free(g);
}
