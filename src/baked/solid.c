/* From density to a solid: smoothing, and filling enclosed cavities. */
#include <math.h>
#include <string.h>

#include "baked/baked.h"

static size_t grid_count(const cubes_grid *g) {
    return (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
}

/* ---- solid ---- */
typedef struct {
    cubes_grid *g;
    int axis;
} smooth_job;

/* Lines along an axis; the outermost points stay. */
static void smooth_range(void *arg, int64_t begin, int64_t end, int thread) {
    const smooth_job *job = arg;
    const cubes_grid *g = job->g;
    const size_t stride[3] = {1, (size_t)g->size[0], (size_t)g->size[0] * (size_t)g->size[1]};
    int a = job->axis, u = a == 0 ? 1 : 0;
    int v = 3 - a - u;
    for (int64_t line = begin; line < end; line++) {
        float *at =
            g->value + (size_t)(line % g->size[u]) * stride[u] + (size_t)(line / g->size[u]) * stride[v];
        float before = at[0];
        for (int k = 1; k + 1 < g->size[a]; k++) {
            float *x = at + (size_t)k * stride[a], own = *x;
            *x = 0.25f * before + 0.5f * own + 0.25f * x[stride[a]];
            before = own;
        }
    }
}

void field_smooth(const context *c, cubes_grid *g) {
    for (int a = 0; a < 3; a++) {
        smooth_job job = {g, a};
        parallel_for(c, (int64_t)(grid_count(g) / (size_t)g->size[a]), 1024, smooth_range, &job);
    }
}

sherf_status field_flood(context *c, cubes_grid *g, float level, uint8_t *outside) {
    const size_t count = grid_count(g), X = (size_t)g->size[0], XY = X * (size_t)g->size[1];
    uint32_t *stack = mem_alloc(c, count, sizeof *stack); /* FIELD_POINTS_MAX is far below 2^32 */
    size_t n = 0;
    if (!stack) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < count; i++) {
        size_t x = i % X, y = i / X % (size_t)g->size[1], z = i / XY;
        bool rim = !x || !y || !z || x + 1 == X || y + 1 == (size_t)g->size[1] || z + 1 == (size_t)g->size[2];
        if (!rim) continue;
        outside[i] = 1; /* whatever its density: the grid's rim is empty */
        if (g->value[i] >= level) g->value[i] = 0;
        stack[n++] = (uint32_t)i;
    }
    while (n) {
        size_t i = stack[--n], x = i % X, y = i / X % (size_t)g->size[1], z = i / XY;
        const size_t near[6] = {x ? i - 1 : i,  x + 1 < X ? i + 1 : i,
                                y ? i - X : i,  y + 1 < (size_t)g->size[1] ? i + X : i,
                                z ? i - XY : i, z + 1 < (size_t)g->size[2] ? i + XY : i};
        for (int k = 0; k < 6; k++)
            if (!outside[near[k]] && g->value[near[k]] < level) {
                outside[near[k]] = 1;
                stack[n++] = (uint32_t)near[k];
            }
    }
    mem_free(stack);
    return SHERF_OK;
}

sherf_status field_solidify(context *c, cubes_grid *g, float level) {
    const size_t count = grid_count(g);
    float max = 0;
    for (size_t i = 0; i < count; i++) {
        max = fmaxf(max, g->value[i]);
        g->value[i] = g->value[i] < 0 ? 2 * level : field_saturate(g->value[i], level);
    }
    if (max < level)
        return failure(c, SHERF_BAD_ARGUMENT, "level %g: the avatar is nowhere that dense, but %g at most",
                       (double)level, (double)max);
    uint8_t *outside = mem_zero(c, count, 1);
    if (!outside) return SHERF_NO_MEMORY;
    field_smooth(c, g);
    sherf_status status = field_flood(c, g, level, outside);
    for (size_t i = 0; i < count && status == SHERF_OK; i++)
        if (!outside[i] && g->value[i] < level) g->value[i] = 2 * level;
    mem_free(outside);
    return status;
}
