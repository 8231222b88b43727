/* The painted body: features of the vertices that the camera sees, in voxels of the observed pose. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "model/nhp/nhp.h"
#include "model/stages.h"

static const float hidden_m = 0.02f;

/* ---- geometry ---- */
/* Visible: not behind the body's rasterised mesh at the vertex's pixel. */
static sherf_status see(context *c, const body_model *body, const sherf_camera *camera, nhp_geometry *own,
                        const float *world, const float *depth) {
    raster *drawn = NULL;
    sherf_status status = raster_create(c, camera, 1, body->vertices, world, body->faces, body->face, &drawn);
    for (int64_t v = 0; v < body->vertices && status == SHERF_OK; v++) {
        const float x = rintf(own->vertex_px[2 * v]), y = rintf(own->vertex_px[2 * v + 1]);
        const bool inside =
            depth[v] > 0 && x >= 0 && y >= 0 && x < (float)drawn->width && y < (float)drawn->height;
        own->visible[v] =
            inside && depth[v] <= drawn->depth[(size_t)y * (size_t)drawn->width + (size_t)x] + hidden_m;
    }
    raster_free(drawn);
    return status;
}

static sherf_status lay_out(context *c, const model_config *config, const body_model *body,
                            const posed_body *posed, nhp_geometry *own) {
    const float voxel = nhp_settings_of(config)->voxel_size_m;
    int32_t *zyx = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *zyx);
    sherf_status status = zyx ? SHERF_OK : SHERF_NO_MEMORY;
    for (int k = 0; k < 3 && status == SHERF_OK; k++) {
        own->min_smpl[k] = posed->min_smpl[k] - BODY_SHELL_M;
        const float cells = ceilf((posed->max_smpl[k] + BODY_SHELL_M - own->min_smpl[k]) / voxel);
        if (!(cells >= 1 && cells <= 2048))
            status = failure(c, SHERF_BAD_ARGUMENT, "the posed body is %g m wide: not a body in metres",
                             (double)(posed->max_smpl[k] - posed->min_smpl[k]));
        else
            for (int l = 0; l <= NHP_LEVELS; l++) own->level[l].size[2 - k] = (((int)cells | 31) + 1) >> l;
    }
    for (int64_t i = 0; i < 3 * (int64_t)body->vertices && status == SHERF_OK; i++) {
        const int k = (int)(i % 3), last = own->level[0].size[2 - k] - 1;
        const float at = rintf((posed->vertices_smpl[i] - own->min_smpl[k]) / voxel);
        zyx[i - k + 2 - k] = at >= 0 ? at <= (float)last ? (int)at : last : 0;
    }
    if (status == SHERF_OK)
        status = sparse_levels_create(c, own->level, NHP_LEVELS + 1, NHP_LEVELS + 1, body->vertices, zyx);
    for (int64_t v = 0; v < body->vertices && status == SHERF_OK; v++)
        own->vertex_voxel[v] = own->level[0].grid[sparse_voxel(own->level, zyx + 3 * v)];
    mem_free(zyx);
    return status;
}

sherf_status nhp_observe(context *c, const model_config *config, const body_model *body, bool training,
                         observation_geometry *g) {
    const size_t V = (size_t)body->vertices;
    nhp_geometry *own = g->own = mem_zero(c, 1, sizeof *own);
    if (!own) return SHERF_NO_MEMORY;
    own->visible = mem_alloc(c, V, sizeof *own->visible);
    own->vertex_px = mem_alloc(c, V, 2 * sizeof *own->vertex_px);
    own->vertex_voxel = mem_alloc(c, V, sizeof *own->vertex_voxel);
    float *world = mem_alloc(c, V, 4 * sizeof *world);
    sherf_status status =
        own->visible && own->vertex_px && own->vertex_voxel && world ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        body_vertices_world(body, g->body, world);
        camera_project(&g->camera, (int64_t)V, world, own->vertex_px, world + 3 * V);
        status = see(c, body, &g->camera, own, world, world + 3 * V);
    }
    if (status == SHERF_OK) status = lay_out(c, config, body, g->body, own);
    mem_free(world);
    return status;
}

void nhp_observed_free(void *geometry) {
    nhp_geometry *own = geometry;
    if (!own) return;
    mem_free(own->visible);
    mem_free(own->vertex_px);
    mem_free(own->vertex_voxel);
    sparse_levels_free(own->level, NHP_LEVELS + 1);
    mem_free(own);
}

sherf_status nhp_level_is(context *c, nhp_geometry *g, int l, int64_t voxels, const int32_t *voxel) {
    sparse_level *level = &g->level[l];
    const int64_t cells = (int64_t)level->size[0] * level->size[1] * level->size[2];
    memset(level->grid, 0xff, (size_t)cells * sizeof *level->grid);
    level->voxels = voxels;
    for (int64_t i = 0; i < voxels; i++) {
        if (voxel[i] < 0 || voxel[i] >= cells || level->grid[voxel[i]] >= 0)
            return failure(c, SHERF_BAD_FILE, "tensor volume.%d.voxel: a voxel outside the volume, or twice",
                           l);
        level->grid[voxel[i]] = (int32_t)i;
    }
    return SHERF_OK;
}

/* ---- network ---- */
void nhp_volume_declare(declaration *d, const nhp_settings *k, nhp_volume *v) {
    char name[LAYER_NAME];
    const int *C = k->volume_channels;
    v->project = linear_declare(d, "volume.project", false, C[0], 4 * (int64_t)k->encoder_width);
    for (int l = 0; l <= NHP_LEVELS; l++) {
        const int64_t out = C[l ? l - 1 : 0], in = C[l > 1 ? l - 2 : 0];
        if (l) {
            snprintf(name, sizeof name, "volume.down%d", l);
            v->down[l - 1] = sparse_declare(d, name, 0, true, out, in);
        }
        snprintf(name, sizeof name, "volume.level%d", l);
        for (int i = 0; i < (l < 2 ? 2 : NHP_CONVOLUTIONS); i++)
            v->conv[l][i] = sparse_declare(d, name, 2 * i, true, out, out);
    }
}

static tensor *rule_of(tape *t, const int32_t *rule, int64_t voxels) {
    return tape_input_i32(t, rule, 2, (int64_t[]){voxels, 27});
}

void nhp_volume_encode(tape *t, const nhp_volume *v, const observation_geometry *g, tensor *map,
                       tensor *level[NHP_LEVELS]) {
    const nhp_geometry *own = g->own;
    const int64_t V = g->vertices;
    float *at = tape_alloc(t, (size_t)V, 2 * sizeof *at);
    if (!at || !map) return;
    const map_place place = map_place_of(map, g->width, g->height);
    for (int64_t i = 0; i < V; i++) map_position(&place, own->vertex_px + 2 * i, at + 2 * i);
    tensor *x = op_sample_bilinear(t, map, tape_input(t, at, 2, (int64_t[]){V, 2}));
    x = op_mask_rows(t, linear_forward(t, &v->project, x), tape_input_i32(t, own->visible, 1, &V));
    x = op_scatter_mean(t, x, tape_input_i32(t, own->vertex_voxel, 1, &V), own->level[0].voxels);
    for (int l = 0; l <= NHP_LEVELS; l++) {
        const int64_t voxels = own->level[l].voxels;
        if (l) x = sparse_forward(t, &v->down[l - 1], x, rule_of(t, own->level[l - 1].down_rule, voxels));
        tensor *rule = rule_of(t, own->level[l].rule, voxels);
        for (int i = 0; i < NHP_CONVOLUTIONS && v->conv[l][i].w; i++)
            x = sparse_forward(t, &v->conv[l][i], x, rule);
        if (l) level[l - 1] = x;
    }
}

tensor *nhp_volume_at(tape *t, const nhp_settings *k, const observation_geometry *g,
                      tensor *const level[NHP_LEVELS], const float *points_world, int64_t count) {
    const nhp_geometry *own = g->own;
    const float *R = g->body->R, *Th = g->body->Th;
    tensor *out[NHP_LEVELS];
    for (int l = 0; l < NHP_LEVELS; l++) {
        const int *size = own->level[l + 1].size;
        float *p = tape_alloc(t, (size_t)count + 1, 3 * sizeof *p);
        if (!p) return NULL;
        for (int64_t i = 0; i < count; i++) {
            const float *x = points_world + 3 * i;
            const float y[3] = {x[0] - Th[0], x[1] - Th[1], x[2] - Th[2]};
            for (int a = 0; a < 3; a++) {
                const float smpl = y[0] * R[a] + y[1] * R[3 + a] + y[2] * R[6 + a];
                const float full = (float)own->level[0].size[2 - a];
                p[3 * i + a] = (smpl - own->min_smpl[a]) / k->voxel_size_m / full * (float)(size[2 - a] - 1);
            }
        }
        tensor *grid =
            tape_constant(t, T_I32, 3, (int64_t[]){size[0], size[1], size[2]}, own->level[l + 1].grid);
        out[l] = op_sample_trilinear(t, level[l], grid, tape_input(t, p, 2, (int64_t[]){count, 3}));
    }
    return op_concat(t, NHP_LEVELS, out);
}
