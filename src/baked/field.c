/* The network's density and colour at any canonical point. */
#include <math.h>
#include <string.h>

#include "baked/baked.h"
#include "avatar/canonical.h"

/* Deeper than this below the body's skin everything is solid: nobody sees the network's density there, and it
 * has holes. */
static const float core_m = 0.015f, sigma_max = 1e6f;

/* ---- any points ---- */
typedef struct {
    const sherf_avatar *a;
    const body_model *body;
    const float *point;
    int32_t *nearest; /* -1: outside the shell */
} near_job;

static void find_near(void *arg, int64_t begin, int64_t end, int thread) {
    const near_job *j = arg;
    int32_t guess = -1;
    for (int64_t i = begin; i < end; i++) {
        float d2;
        int32_t found = vertex_grid_nearest_from(body_canonical_grid(j->body), j->point + 3 * i, guess, &d2);
        if (found >= 0) guess = found;
        j->nearest[i] = found >= 0 && d2 < BODY_SHELL_M * BODY_SHELL_M ? found : -1;
    }
}

sherf_status field_query(context *c, const sherf_avatar *a, const body_model *body, int64_t n,
                         const float *points_canonical, const float *directions_canonical, float *rgb,
                         float *sigma) {
    if (avatar_check_body(c, a, body) != SHERF_OK) return SHERF_MISMATCH;
    canonical_batch b;
    int32_t *nearest = mem_alloc(c, CANONICAL_BATCH, sizeof *nearest),
            *from = mem_alloc(c, CANONICAL_BATCH, sizeof *from);
    sherf_status status = canonical_batch_make(c, CANONICAL_BATCH, &b);
    if (!nearest || !from) status = SHERF_NO_MEMORY;
    for (int64_t at = 0; at < n && status == SHERF_OK; at += CANONICAL_BATCH) {
        int64_t count = n - at < CANONICAL_BATCH ? n - at : CANONICAL_BATCH;
        near_job job = {a, body, points_canonical + 3 * at, nearest};
        parallel_for(c, count, 1024, find_near, &job);
        b.set.count = 0;
        for (int64_t i = 0; i < count; i++) {
            sigma[at + i] = SIGMA_EMPTY;
            memset(rgb + 3 * (at + i), 0, 3 * sizeof *rgb);
            if (nearest[i] < 0) continue;
            int64_t k = b.set.count++;
            from[k] = (int32_t)i;
            b.nearest[k] = nearest[i];
            memcpy(b.set.canonical + 3 * k, points_canonical + 3 * (at + i), 3 * sizeof(float));
            memcpy(b.set.direction_canonical + 3 * k, directions_canonical + 3 * (at + i), 3 * sizeof(float));
        }
        if (b.set.count) status = canonical_batch_run(c, a, body, &b);
        for (int64_t k = 0; k < b.set.count && status == SHERF_OK; k++) {
            sigma[at + from[k]] = b.sigma[k];
            memcpy(rgb + 3 * (at + from[k]), b.rgb + 3 * k, 3 * sizeof *rgb);
        }
    }
    canonical_batch_free(&b);
    mem_free(nearest);
    mem_free(from);
    return status;
}

/* ---- the grid ---- */
static sherf_status grid_make(context *c, const body_model *body, int resolution, cubes_grid *g) {
    enum { RIM = 2 };
    float max[3], longest = 0;
    *g = (cubes_grid){0};
    if (resolution < EXPORT_RESOLUTION_MIN || resolution > EXPORT_RESOLUTION_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "resolution %d: must be %d to %d", resolution,
                       EXPORT_RESOLUTION_MIN, EXPORT_RESOLUTION_MAX);
    body_canonical_bounds(body, g->min, max);
    for (int k = 0; k < 3; k++) longest = fmaxf(longest, max[k] - g->min[k]);
    g->step_m = longest / (float)resolution;
    size_t count = 1;
    for (int k = 0; k < 3; k++) {
        g->min[k] -= RIM * g->step_m;
        g->size[k] = (int)ceilf((max[k] - g->min[k]) / g->step_m) + RIM + 1;
        count *= (size_t)g->size[k];
    }
    if (count > FIELD_POINTS_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "resolution %d: %zu million points are too many for this body",
                       resolution, count / 1000000);
    g->value = mem_zero(c, count, sizeof *g->value);
    return g->value ? SHERF_OK : SHERF_NO_MEMORY;
}

typedef struct {
    /* of the canonical vertices; finds vertices within the shell only, so it is quick far outside */
    const vertex_grid *near;
    const cubes_grid *g;
    int32_t *nearest; /* of the grid's points */
} shell_job;

static void shell_range(void *arg, int64_t begin, int64_t end, int thread) {
    const shell_job *j = arg;
    const cubes_grid *g = j->g;
    for (int64_t row = begin; row < end; row++) {
        int y = (int)(row % g->size[1]), z = (int)(row / g->size[1]);
        int32_t guess = -1;
        for (int x = 0; x < g->size[0]; x++) {
            float p[3] = {g->min[0] + g->step_m * (float)x, g->min[1] + g->step_m * (float)y,
                          g->min[2] + g->step_m * (float)z};
            guess = vertex_grid_nearest_from(j->near, p, guess, NULL);
            j->nearest[cubes_at(g, x, y, z)] = guess;
        }
    }
}

/* Does grid point i lie more than core_m below its nearest vertex's tangent plane? */
static bool in_core(const body_model *body, const cubes_grid *g, const float *normal, const int32_t *nearest,
                    size_t i) {
    const size_t X = (size_t)g->size[0], Y = (size_t)g->size[1];
    const size_t at[3] = {i % X, i / X % Y, i / X / Y}, v = 3 * (size_t)nearest[i];
    float height = 0;
    for (size_t k = 0; k < 3; k++)
        height +=
            normal[v + k] * (g->min[k] + g->step_m * (float)at[k] - body->canonical->vertices_smpl[v + k]);
    return height < -core_m;
}

/* Nearest vertices of the grid's points, -1 outside the shell and in the body's core. The core's value
 * becomes negative: minus the density that is half opaque after one step. */
static sherf_status find_shell(context *c, const body_model *body, const float *normal, cubes_grid *g,
                               int32_t *nearest) {
    const size_t count = (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
    const float core = -0.7f / g->step_m; /* half opaque in one step */
    vertex_grid *near = NULL;
    uint8_t *outside = mem_zero(c, count, 1);
    sherf_status status = outside ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK)
        status = vertex_grid_create(c, body->vertices, body->canonical->vertices_smpl, BODY_SHELL_M, &near);
    if (status == SHERF_OK) status = vertex_grid_refine(c, near, BODY_SHELL_M, 0.02f);
    if (status == SHERF_OK) {
        shell_job job = {near, g, nearest};
        parallel_for(c, (int64_t)g->size[1] * g->size[2], 16, shell_range, &job);
        for (size_t i = 0; i < count; i++) g->value[i] = nearest[i] >= 0 ? 1 : 0;
        status = field_flood(c, g, 0.5f, outside);
        for (size_t i = 0; i < count; i++) {
            if (nearest[i] >= 0 && in_core(body, g, normal, nearest, i)) nearest[i] = -1, outside[i] = 0;
            g->value[i] = nearest[i] >= 0 || outside[i] ? 0 : core;
        }
    }
    vertex_grid_free(near);
    mem_free(outside);
    return status;
}

sherf_status field_density(context *c, const sherf_avatar *a, const body_model *body, int resolution,
                           cubes_grid *out) {
    if (avatar_check_body(c, a, body) != SHERF_OK) return SHERF_MISMATCH;
    cubes_grid *g = out;
    canonical_batch b = {0};
    int32_t *nearest = NULL;
    size_t *from = NULL;
    float *normal = NULL;
    sherf_status status = grid_make(c, body, resolution, g);
    if (status != SHERF_OK) return status;
    const size_t count = (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
    nearest = mem_alloc(c, count, sizeof *nearest);
    from = mem_alloc(c, CANONICAL_BATCH, sizeof *from);
    normal = mem_alloc(c, (size_t)body->vertices, 3 * sizeof *normal);
    status = canonical_batch_make(c, CANONICAL_BATCH, &b);
    if (!nearest || !from || !normal) status = SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = body_normals(c, body, body->canonical->vertices_smpl, normal);
    if (status == SHERF_OK) status = find_shell(c, body, normal, g, nearest);
    if (status != SHERF_OK) goto done;
    for (size_t i = 0; i < count && status == SHERF_OK; i++) {
        if (nearest[i] >= 0) {
            int64_t k = b.set.count++;
            size_t x = i % (size_t)g->size[0], row = i / (size_t)g->size[0], y = row % (size_t)g->size[1],
                   z = row / (size_t)g->size[1];
            float at[3] = {(float)x, (float)y, (float)z};
            for (int d = 0; d < 3; d++) {
                b.set.canonical[3 * k + d] = g->min[d] + g->step_m * at[d];
                b.set.direction_canonical[3 * k + d] = -normal[3 * nearest[i] + d];
            }
            b.nearest[k] = nearest[i];
            from[k] = i;
        }
        if (b.set.count < CANONICAL_BATCH && i + 1 < count) continue;
        if (b.set.count) status = canonical_batch_run(c, a, body, &b);
        if (status == SHERF_OK) status = progress(c, "density", (double)(i + 1), (double)count);
        for (int64_t k = 0; k < b.set.count; k++) g->value[from[k]] = fminf(fmaxf(b.sigma[k], 0), sigma_max);
        b.set.count = 0;
    }
done:
    canonical_batch_free(&b);
    mem_free(nearest);
    mem_free(from);
    mem_free(normal);
    if (status != SHERF_OK) cubes_grid_free(out);
    return status;
}
