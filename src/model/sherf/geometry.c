/* What the body and the observation's camera decide for the point-level features: which vertices are seen,
 * the sparse volume's voxels and the rules of its convolutions (network.md 3). */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model/sherf/sherf.h"

/* Rows [begin, end) of a stride-1 or stride-2 rule: out[o] = sum_k W[k] in[stride * o + k - 1]. */
typedef struct {
    const int32_t *zyx;  /* of the output voxels, 3 each */
    const int32_t *grid; /* of the input level */
    const int *size;     /* of the input level */
    int stride;
    int32_t *rule;
} rule_job;

static void rule_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const rule_job *j = arg;
    for (int64_t o = begin; o < end; o++)
        for (int k = 0; k < 27; k++) {
            int z = j->zyx[3 * o] * j->stride + k / 9 - 1;
            int y = j->zyx[3 * o + 1] * j->stride + k / 3 % 3 - 1;
            int x = j->zyx[3 * o + 2] * j->stride + k % 3 - 1;
            bool inside = z >= 0 && y >= 0 && x >= 0 && z < j->size[0] && y < j->size[1] && x < j->size[2];
            j->rule[27 * o + k] = inside ? j->grid[((int64_t)z * j->size[1] + y) * j->size[2] + x] : -1;
        }
}

static int32_t *rule_create(context *c, int64_t voxels, const int32_t *zyx, const int32_t *grid,
                            const int size[3], int stride) {
    int32_t *rule = mem_alloc(c, (size_t)voxels * 27, sizeof *rule);
    if (!rule) return NULL;
    rule_job job = {zyx, grid, size, stride, rule};
    parallel_for(c, voxels, 256, rule_rows, &job);
    return rule;
}

static int compare_i64(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

/* Sorted, unique linear voxel numbers -> the level's grid and the voxels' z, y, x. */
static sherf_status level_fill(context *c, sherf_geometry *g, int l, int64_t *number, int64_t count,
                               int32_t **zyx) {
    int *size = g->level[l].size;
    qsort(number, (size_t)count, sizeof *number, compare_i64);
    int64_t unique = 0;
    for (int64_t i = 0; i < count; i++)
        if (!i || number[i] != number[i - 1]) number[unique++] = number[i];
    size_t cells = (size_t)size[0] * (size_t)size[1] * (size_t)size[2];
    int32_t *grid = mem_alloc(c, cells, sizeof *grid);
    *zyx = mem_alloc(c, (size_t)unique * 3, sizeof **zyx);
    g->level[l].grid = grid;
    g->level[l].voxels = unique;
    if (!grid || !*zyx) return SHERF_NO_MEMORY;
    memset(grid, 0xff, cells * sizeof *grid);
    for (int64_t i = 0; i < unique; i++) {
        grid[number[i]] = (int32_t)i;
        (*zyx)[3 * i] = (int32_t)(number[i] / ((int64_t)size[1] * size[2]));
        (*zyx)[3 * i + 1] = (int32_t)(number[i] / size[2] % size[1]);
        (*zyx)[3 * i + 2] = (int32_t)(number[i] % size[2]);
    }
    return SHERF_OK;
}

/* The voxels a stride-2 layer reaches: 2 o + k - 1 = i for some k in 0..2. At most two per axis. */
static int64_t *reached(context *c, int64_t voxels, const int32_t *zyx, const int size[3], int64_t *count) {
    int64_t *number = mem_alloc(c, (size_t)voxels * 8 + 1, sizeof *number), n = 0;
    if (!number) return NULL;
    for (int64_t i = 0; i < voxels; i++) {
        int low[3], high[3];
        for (int a = 0; a < 3; a++) {
            int v = zyx[3 * i + a];
            low[a] = v / 2; /* ceil((v - 1) / 2) for v >= 0 */
            high[a] = (v + 1) / 2 < size[a] ? (v + 1) / 2 : size[a] - 1;
        }
        for (int z = low[0]; z <= high[0]; z++)
            for (int y = low[1]; y <= high[1]; y++)
                for (int x = low[2]; x <= high[2]; x++)
                    number[n++] = ((int64_t)z * size[1] + y) * size[2] + x;
    }
    *count = n;
    return number;
}

static sherf_status levels_create(context *c, sherf_geometry *g, int vertices, bool further) {
    int32_t *zyx = NULL, *next_zyx = NULL;
    int64_t count = vertices, *number = mem_alloc(c, (size_t)vertices, sizeof *number);
    sherf_status status = number ? SHERF_OK : SHERF_NO_MEMORY;
    const int *size = g->level[0].size;
    for (int v = 0; number && v < vertices; v++)
        number[v] = ((int64_t)g->vertex_zyx[3 * v] * size[1] + g->vertex_zyx[3 * v + 1]) * size[2] +
                    g->vertex_zyx[3 * v + 2];
    int levels = further ? g->levels + 2 : g->levels + 1;
    for (int l = 0; l < levels && status == SHERF_OK; l++) {
        status = level_fill(c, g, l, number, count, &next_zyx);
        mem_free(number);
        number = NULL;
        if (status != SHERF_OK) break;
        if (l) {
            g->level[l - 1].down_rule =
                rule_create(c, g->level[l].voxels, next_zyx, g->level[l - 1].grid, g->level[l - 1].size, 2);
            if (!g->level[l - 1].down_rule) status = SHERF_NO_MEMORY;
        }
        mem_free(zyx);
        zyx = next_zyx;
        next_zyx = NULL;
        if (l <= g->levels && status == SHERF_OK) {
            g->level[l].rule = rule_create(c, g->level[l].voxels, zyx, g->level[l].grid, g->level[l].size, 1);
            if (!g->level[l].rule) status = SHERF_NO_MEMORY;
        }
        if (l + 1 < levels && status == SHERF_OK) {
            number = reached(c, g->level[l].voxels, zyx, g->level[l + 1].size, &count);
            if (!number) status = SHERF_NO_MEMORY;
        }
    }
    mem_free(number);
    mem_free(zyx);
    mem_free(next_zyx);
    return status;
}

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

/* Voxel of each vertex, the volume's sizes, the active voxels and rules of every level (network.md 3). The
 * observation's vertices go to canonical space by the inverse LBS, which puts them on the canonical body. */
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
        status = levels_create(c, g, body->vertices, further);
    }
    for (int v = 0; status == SHERF_OK && v < body->vertices; v++)
        g->vertex_voxel[v] =
            g->level[0].grid[((int64_t)g->vertex_zyx[3 * v] * g->volume_size[1] + g->vertex_zyx[3 * v + 1]) *
                                 g->volume_size[2] +
                             g->vertex_zyx[3 * v + 2]];
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
        body_vertices_world(body, observation->body, world);
        camera_project(&observation->camera, (int64_t)V, world, g->vertex_px, NULL);
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
    for (size_t l = 0; l < COUNT_OF(g->level); l++) {
        mem_free(g->level[l].grid);
        mem_free(g->level[l].rule);
        mem_free(g->level[l].down_rule);
    }
    mem_free(g);
}
