/* Surfaces: their connected components, their normals. */
#include <math.h>
#include <string.h>

#include "baked/baked.h"

void surface_cross(const surface *s, int64_t t, double out[3]) {
    const float *p[3];
    double u[3], v[3];
    for (int k = 0; k < 3; k++) p[k] = s->position + 3 * (size_t)s->triangle[3 * t + k];
    for (int k = 0; k < 3; k++) u[k] = (double)p[1][k] - p[0][k], v[k] = (double)p[2][k] - p[0][k];
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

/* ---- components ---- */
static uint32_t root_of(uint32_t *parent, uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
}

/* Area and six times the volume by component; both at its root. */
static void measure(const surface *s, uint32_t *parent, double *area, double *volume) {
    for (int64_t v = 0; v < s->vertices; v++) parent[v] = (uint32_t)v;
    for (int64_t t = 0; t < s->triangles; t++)
        for (int k = 1; k < 3; k++) {
            uint32_t a = root_of(parent, s->triangle[3 * t]), b = root_of(parent, s->triangle[3 * t + k]);
            parent[a > b ? a : b] = a > b ? b : a;
        }
    for (int64_t t = 0; t < s->triangles; t++) {
        const uint32_t root = root_of(parent, s->triangle[3 * t]);
        const float *p = s->position + 3 * (size_t)s->triangle[3 * t];
        double n[3];
        surface_cross(s, t, n);
        area[root] += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
        volume[root] += n[0] * p[0] + n[1] * p[1] + n[2] * p[2];
    }
}

/* Keeps the triangles whose vertices have keep[] set, and the vertices they use. number: room for V. */
static void compact(surface *s, const uint8_t *keep, uint32_t *number) {
    int64_t vertices = 0, triangles = 0;
    for (int64_t v = 0; v < s->vertices; v++) {
        if (!keep[v]) continue;
        memmove(s->position + 3 * vertices, s->position + 3 * v, 3 * sizeof *s->position);
        if (s->normal) memmove(s->normal + 3 * vertices, s->normal + 3 * v, 3 * sizeof *s->normal);
        number[v] = (uint32_t)vertices++;
    }
    for (int64_t t = 0; t < s->triangles; t++) {
        if (!keep[s->triangle[3 * t]]) continue;
        for (int k = 0; k < 3; k++) s->triangle[3 * triangles + k] = number[s->triangle[3 * t + k]];
        triangles++;
    }
    s->vertices = vertices;
    s->triangles = triangles;
}

sherf_status surface_keep_large(context *c, surface *s, double share, int *dropped) {
    const size_t V = (size_t)s->vertices;
    uint32_t *parent = mem_alloc(c, V, sizeof *parent);
    uint8_t *keep = mem_zero(c, V, 1);
    double *area = mem_zero(c, V, sizeof *area), *volume = mem_zero(c, V, sizeof *volume), largest = 0;
    sherf_status status = parent && keep && area && volume ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        int lost = 0;
        measure(s, parent, area, volume);
        for (size_t v = 0; v < V; v++)
            if (volume[v] > 0) largest = fmax(largest, area[v]);
        for (size_t v = 0; v < V; v++) {
            uint32_t root = root_of(parent, (uint32_t)v);
            keep[v] = volume[root] > 0 && area[root] >= share * largest;
            lost += root == v && !keep[v];
        }
        compact(s, keep, parent);
        if (dropped) *dropped = lost;
    }
    mem_free(parent);
    mem_free(keep);
    mem_free(area);
    mem_free(volume);
    return status;
}

/* ---- normals ---- */
/* The grid's gradient at a point, trilinear between central differences at the eight points around it. */
static void grid_gradient(const cubes_grid *g, const float p[3], double out[3]) {
    int cell[3];
    double part[3];
    for (int k = 0; k < 3; k++) {
        double x = ((double)p[k] - g->min[k]) / g->step_m, last = g->size[k] - 3;
        x = x > 1 ? x < last ? x : last : 1; /* one point of margin for the differences */
        cell[k] = (int)x;
        part[k] = x - cell[k];
    }
    memset(out, 0, 3 * sizeof *out);
    for (int corner = 0; corner < 8; corner++) {
        double weight = 1;
        int at[3];
        for (int k = 0; k < 3; k++) {
            at[k] = cell[k] + (corner >> k & 1);
            weight *= corner >> k & 1 ? part[k] : 1 - part[k];
        }
        for (int k = 0; k < 3; k++) {
            int low[3] = {at[0], at[1], at[2]}, high[3] = {at[0], at[1], at[2]};
            low[k]--, high[k]++;
            out[k] += weight * ((double)g->value[cubes_at(g, high[0], high[1], high[2])] -
                                g->value[cubes_at(g, low[0], low[1], low[2])]);
        }
    }
}

sherf_status surface_normals(context *c, surface *s, const cubes_grid *g) {
    const size_t V = (size_t)s->vertices;
    double *sum = mem_zero(c, V, 3 * sizeof *sum);
    float *normal = mem_alloc(c, V, 3 * sizeof *normal);
    if (!sum || !normal) {
        mem_free(sum);
        mem_free(normal);
        return SHERF_NO_MEMORY;
    }
    for (int64_t t = 0; t < s->triangles; t++) {
        double n[3];
        surface_cross(s, t, n);
        for (int i = 0; i < 9; i++) sum[3 * (size_t)s->triangle[3 * t + i / 3] + (size_t)(i % 3)] += n[i % 3];
    }
    for (size_t v = 0; v < V; v++) {
        double n[3], *flat = sum + 3 * v;
        double flat_length = sqrt(flat[0] * flat[0] + flat[1] * flat[1] + flat[2] * flat[2]);
        for (int k = 0; k < 3; k++) flat[k] = flat_length > 0 ? flat[k] / flat_length : k == 1;
        memcpy(n, flat, sizeof n);
        if (g) {
            double slope[3], length, along;
            grid_gradient(g, s->position + 3 * v, slope);
            length = sqrt(slope[0] * slope[0] + slope[1] * slope[1] + slope[2] * slope[2]);
            along = -(slope[0] * flat[0] + slope[1] * flat[1] + slope[2] * flat[2]);
            if (along > 0.5 * length && length > 0) /* within 60 degrees of the triangles' */
                for (int k = 0; k < 3; k++) n[k] = -slope[k] / length;
        }
        for (int k = 0; k < 3; k++) normal[3 * v + (size_t)k] = (float)n[k];
    }
    mem_free(sum);
    mem_free(s->normal);
    s->normal = normal;
    return SHERF_OK;
}
