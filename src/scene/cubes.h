/* cubes: marching cubes, from values on a regular grid to a closed surface. */
#ifndef SHERF_CUBES_H
#define SHERF_CUBES_H

#include "base/base.h"

/* Point (x, y, z) lies at min + step_m (x, y, z); value[(z * size[1] + y) * size[0] + x]. */
typedef struct {
    int size[3]; /* x y z */
    float min[3], step_m;
    float *value;
} cubes_grid;
void cubes_grid_free(cubes_grid *g);
static inline size_t cubes_at(const cubes_grid *g, int x, int y, int z) {
    return ((size_t)z * (size_t)g->size[1] + (size_t)y) * (size_t)g->size[0] + (size_t)x;
}

typedef struct {
    int64_t vertices, triangles;
    float *position;    /* V x 3 */
    float *normal;      /* V x 3, unit, outwards; NULL until made */
    uint32_t *triangle; /* T x 3, counter-clockwise seen from outside */
} surface;
void surface_free(surface *s);

/* The surface where the grid's value is `level`, solid above it. It is closed (every edge has two triangles,
 * every vertex one fan) and oriented, provided the grid's outermost points are below the level. */
sherf_status cubes_surface(context *c, const cubes_grid *g, float level, surface *out);

#endif
