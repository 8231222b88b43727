/* From density to a solid: the level of its surface, and what lies enclosed. */
#include <math.h>
#include <string.h>

#include "export/export.h"

static size_t grid_count(const field_grid *g) {
    return (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
}

/* ---- level ---- */
enum { LEVEL_BINS = 512 };
static const double bins_per_octave = 32, half_opaque = 0.6931471805599453; /* optical depth ln 2 */

/* Densities 1 to 65536 per metre, logarithmically. */
static int bin_of(double density) {
    if (!(density > 1)) return 0;
    double b = bins_per_octave * log2(density);
    return b < LEVEL_BINS - 1 ? (int)b : LEVEL_BINS - 1;
}

sherf_status field_level(context *c, const field_grid *g, float *level) {
    /* by bin of a column's largest density: columns that are opaque, and that are not but hold something */
    int64_t opaque[LEVEL_BINS] = {0}, clear[LEVEL_BINS] = {0}, opaque_total = 0;
    const size_t stride[3] = {1, (size_t)g->size[0], (size_t)g->size[0] * (size_t)g->size[1]};
    for (int a = 0; a < 3; a++) {
        int u = (a + 1) % 3, v = (a + 2) % 3;
        for (int j = 0; j < g->size[v]; j++)
            for (int i = 0; i < g->size[u]; i++) {
                const float *at = g->value + (size_t)i * stride[u] + (size_t)j * stride[v];
                double depth = 0, most = 0;
                for (int k = 0; k < g->size[a]; k++) {
                    double density = at[(size_t)k * stride[a]];
                    depth += density < 0 ? half_opaque : density * g->step_m; /* the core is opaque */
                    most = fmax(most, density);
                }
                if (depth >= half_opaque)
                    opaque[bin_of(most)]++, opaque_total++;
                else
                    clear[bin_of(most)]++;
            }
    }
    if (!opaque_total)
        return failure(
            c, SHERF_BAD_ARGUMENT,
            "export: the avatar is nowhere opaque, so that it has no surface (was its model trained?)");
    /* wrong columns when the level lies below bin b: clear ones from b on, opaque ones before it. The middle
     * of the best, which are many where the density jumps. */
    int64_t wrong = 0, best;
    int first = 0, last = 0;
    for (int b = 0; b < LEVEL_BINS; b++) wrong += clear[b];
    best = wrong;
    for (int b = 1; b < LEVEL_BINS; b++) {
        wrong += opaque[b - 1] - clear[b - 1];
        if (wrong < best) best = wrong, first = b;
        if (wrong == best) last = b;
    }
    *level = (float)exp2((first + last) / (2 * bins_per_octave));
    return SHERF_OK;
}

/* ---- solid ---- */
typedef struct {
    field_grid *g;
    int axis;
} smooth_job;

/* Lines along an axis; the outermost points stay. */
static void smooth_range(void *arg, int64_t begin, int64_t end, int thread) {
    const smooth_job *job = arg;
    const field_grid *g = job->g;
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

sherf_status field_flood(context *c, field_grid *g, float level, uint8_t *outside) {
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

sherf_status field_solidify(context *c, field_grid *g, float level) {
    const size_t count = grid_count(g);
    float most = 0;
    for (size_t i = 0; i < count; i++) {
        most = fmaxf(most, g->value[i]);
        if (g->value[i] < 0) g->value[i] = 2 * level;
    }
    if (most < level)
        return failure(c, SHERF_BAD_ARGUMENT, "level %g: the avatar is nowhere that dense, but %g at most",
                       (double)level, (double)most);
    uint8_t *outside = mem_zero(c, count, 1);
    if (!outside) return SHERF_NO_MEMORY;
    for (int a = 0; a < 3; a++) {
        smooth_job job = {g, a};
        parallel_for(c, (int64_t)(count / (size_t)g->size[a]), 1024, smooth_range, &job);
    }
    sherf_status status = field_flood(c, g, level, outside);
    for (size_t i = 0; i < count && status == SHERF_OK; i++)
        if (!outside[i] && g->value[i] < level) g->value[i] = 2 * level;
    mem_free(outside);
    return status;
}
