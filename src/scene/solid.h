/* solid: finds the inside of triangles that need not be closed, and places on their surface. Clothes are open
 * shells over a body with missing hidden faces, so counting rays does not work: cells that a triangle touches
 * are walls, and cells that cannot be reached from outside between walls are inside. */
#ifndef SHERF_SOLID_H
#define SHERF_SOLID_H

#include "base/base.h"

typedef struct {
    int64_t vertices, triangles;
    const float *vertex;      /* V x 3 */
    const uint32_t *triangle; /* T x 3 */
} solid_mesh;

enum { SOLID_OUTSIDE, SOLID_WALL, SOLID_INSIDE };
enum { SOLID_CELLS_MAX = 400000000, SOLID_SEAL_MAX = 64 };
/* Cell (x, y, z) is the cube at min + cell_m (x, y, z); cell[(z * size[1] + y) * size[0] + x]. At least two
 * layers of cells round the triangles are outside. */
typedef struct {
    int size[3];
    float min[3], cell_m;
    uint8_t *cell; /* SOLID_OUTSIDE and so on */
} solid_grid;
void solid_grid_free(solid_grid *g);
/* seal: gaps of up to twice this many cells do not let the flood in, where shells end over a body (0: no
 * gaps); crevices as narrow count as inside. SHERF_BAD_ARGUMENT for missing or non-finite corners, no
 * triangles, more than SOLID_CELLS_MAX cells, and a seal outside 0 to SOLID_SEAL_MAX. */
sherf_status solid_grid_create(context *c, int meshes, const solid_mesh *mesh, float cell_m, int seal,
                               solid_grid *out);
/* The kind of the cell at a place; beyond the grid it is outside. */
int solid_at(const solid_grid *g, const float place[3]);
/* Whether the place is in the solid: in an inner cell, or in a wall. A wall is a cell thick, and half of it
 * counts. */
bool solid_contains(const solid_grid *g, const float place[3]);

/* A place on a mesh: position = weighted sum of the corners. */
typedef struct {
    int mesh;
    int64_t triangle;
    float weight[3], position[3], normal[3]; /* unit, by the corners' order */
} solid_point;
/* `count` places, by area, on triangles that are visible from outside: within one cell of it. Fewer if a
 * hundred times as many tries do not find them; *found: how many. */
sherf_status solid_points(context *c, const solid_grid *g, int meshes, const solid_mesh *mesh, uint64_t key,
                          int64_t count, solid_point *out, int64_t *found);

#endif
