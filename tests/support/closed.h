/* Checks by definition that a surface is closed, manifold and oriented. */
#ifndef TEST_CLOSED_H
#define TEST_CLOSED_H

#include <stdio.h>
#include <stdlib.h>

#include "support.h"

#include "baked/baked.h"

static int compare_u64(const void *a, const void *b) {
    uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* Returns the flaw, or NULL. Every directed edge occurs once and so does its reverse; the triangles around
 * every vertex form one fan, and every vertex has a triangle. */
static const char *flaw_of(int64_t vertices, int64_t triangles, const uint32_t *triangle) {
    static char text[200];
    size_t n = 3 * (size_t)triangles;
    uint64_t *edge = malloc(n * sizeof *edge);
    uint32_t *next = malloc(n * sizeof *next); /* the third corner of the edge (a, b), in the edges' order */
    uint32_t *degree = calloc((size_t)vertices, sizeof *degree),
             *seen = calloc((size_t)vertices, sizeof *seen);
    const char *flaw = NULL;
    for (size_t i = 0; i < n && !flaw; i++) {
        uint32_t a = triangle[i], b = triangle[i / 3 * 3 + (i + 1) % 3];
        if (a >= vertices || a == b) flaw = "a triangle with a bad corner";
        edge[i] = (uint64_t)a << 32 | b;
    }
    if (!flaw) qsort(edge, n, sizeof *edge, compare_u64);
    for (size_t i = 0; i < n && !flaw; i++) {
        uint64_t twin = edge[i] << 32 | edge[i] >> 32;
        if (i && edge[i] == edge[i - 1])
            flaw = "an edge with two triangles on one side";
        else if (!bsearch(&twin, edge, n, sizeof *edge, compare_u64))
            flaw = "an edge with one triangle";
    }
    for (size_t i = 0; i < n && !flaw; i++) {
        uint64_t own = (uint64_t)triangle[i] << 32 | triangle[i / 3 * 3 + (i + 1) % 3];
        const uint64_t *at = bsearch(&own, edge, n, sizeof *edge, compare_u64);
        next[at - edge] = triangle[i / 3 * 3 + (i + 2) % 3];
        degree[triangle[i]]++;
    }
    for (size_t i = 0; i < n && !flaw; i++) { /* walk round the vertex from its first edge */
        uint32_t a = (uint32_t)(edge[i] >> 32), b = (uint32_t)edge[i], steps = 0;
        if (seen[a]) continue;
        seen[a] = 1;
        for (uint32_t at = b;;) {
            uint64_t key = (uint64_t)a << 32 | at;
            at = next[(const uint64_t *)bsearch(&key, edge, n, sizeof *edge, compare_u64) - edge];
            if (++steps > degree[a] || at == b) break;
        }
        if (steps != degree[a]) flaw = "a vertex with more than one fan";
    }
    for (int64_t v = 0; v < vertices && !flaw; v++)
        if (!degree[v]) flaw = "a vertex without triangles";
    free(edge), free(next), free(degree), free(seen);
    if (flaw) snprintf(text, sizeof text, "%s", flaw);
    return flaw ? text : NULL;
}

static inline void assert_closed(const surface *s) {
    const char *flaw = flaw_of(s->vertices, s->triangles, s->triangle);
    if (flaw)
        fail_msg("%lld vertices, %lld triangles: %s", (long long)s->vertices, (long long)s->triangles, flaw);
}

static inline double volume_of(const surface *s) {
    double sum = 0;
    for (int64_t t = 0; t < s->triangles; t++) {
        const float *a = s->position + 3 * (size_t)s->triangle[3 * t],
                    *b = s->position + 3 * (size_t)s->triangle[3 * t + 1],
                    *d = s->position + 3 * (size_t)s->triangle[3 * t + 2];
        sum += a[0] * ((double)b[1] * d[2] - (double)b[2] * d[1]) +
               a[1] * ((double)b[2] * d[0] - (double)b[0] * d[2]) +
               a[2] * ((double)b[0] * d[1] - (double)b[1] * d[0]);
    }
    return sum / 6;
}

/* A grid of the given size, step 1 / 16 m, from (-1, -1, -1), empty at its rim. */
static inline cubes_grid grid_of(context *c, int size, double (*value)(const float p[3], void *user),
                                 void *user) {
    cubes_grid g = {.size = {size, size, size}, .min = {-1, -1, -1}, .step_m = 2.0f / (float)(size - 1)};
    g.value = mem_zero(c, (size_t)size * (size_t)size * (size_t)size, sizeof *g.value);
    for (int z = 1; z + 1 < size; z++)
        for (int y = 1; y + 1 < size; y++)
            for (int x = 1; x + 1 < size; x++) {
                float p[3] = {g.min[0] + g.step_m * (float)x, g.min[1] + g.step_m * (float)y,
                              g.min[2] + g.step_m * (float)z};
                g.value[cubes_at(&g, x, y, z)] = (float)value(p, user);
            }
    return g;
}

#endif
