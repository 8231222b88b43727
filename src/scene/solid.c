/* Walls and a flood fill on a grid of cells, and points drawn on triangles by area. */
#include "scene/solid.h"

#include <math.h>
#include <string.h>

#include "base/vector3.h"

void solid_grid_free(solid_grid *g) {
    mem_free(g->cell);
    *g = (solid_grid){0};
}

static size_t cell_at(const solid_grid *g, int x, int y, int z) {
    return ((size_t)z * (size_t)g->size[1] + (size_t)y) * (size_t)g->size[0] + (size_t)x;
}

/* ---- its size ---- */
static sherf_status mesh_check(context *c, const solid_mesh *mesh, float low[3], float high[3]) {
    for (int64_t i = 0; i < 3 * mesh->triangles; i++) {
        if (mesh->triangle[i] >= mesh->vertices)
            return failure(c, SHERF_BAD_ARGUMENT, "a triangle has a corner that is not there");
        const float *v = mesh->vertex + 3 * (size_t)mesh->triangle[i];
        for (int k = 0; k < 3; k++) {
            if (!isfinite(v[k])) return failure(c, SHERF_BAD_ARGUMENT, "a corner is not finite");
            low[k] = fminf(low[k], v[k]);
            high[k] = fmaxf(high[k], v[k]);
        }
    }
    return SHERF_OK;
}

static sherf_status lay_out(context *c, int meshes, const solid_mesh *mesh, float cell_m, int seal,
                            solid_grid *g) {
    const int margin = 2 + seal;
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    double cells = 1;
    sherf_status status = SHERF_OK;
    *g = (solid_grid){.cell_m = cell_m};
    for (int i = 0; i < meshes && status == SHERF_OK; i++) status = mesh_check(c, &mesh[i], low, high);
    if (status != SHERF_OK) return status;
    if (!(cell_m > 0) || !(low[0] <= high[0]))
        return failure(c, SHERF_BAD_ARGUMENT, "no triangles, or no size of cells");
    for (int k = 0; k < 3; k++) {
        const double n = ceil((double)(high[k] - low[k]) / (double)cell_m) + 1 + 2 * margin;
        cells *= n;
        if (!(cells <= SOLID_CELLS_MAX))
            return failure(c, SHERF_BAD_ARGUMENT, "a grid of more than %d cells", SOLID_CELLS_MAX);
        g->size[k] = (int)n;
        g->min[k] = low[k] - ((float)margin + 0.5f) * cell_m;
    }
    g->cell = mem_alloc(c, (size_t)cells, 1);
    if (!g->cell) return SHERF_NO_MEMORY;
    memset(g->cell, SOLID_INSIDE, (size_t)cells);
    return SHERF_OK;
}

/* ---- walls ---- */
/* Whether the axis separates a triangle and a cube: v is relative to the cube's middle, `half` is half its
 * side. */
static bool axis_parts(const double axis[3], const double v[3][3], double half) {
    double low = INFINITY, high = -INFINITY, reach = 0;
    for (int k = 0; k < 3; k++) {
        const double at = axis[0] * v[k][0] + axis[1] * v[k][1] + axis[2] * v[k][2];
        low = fmin(low, at);
        high = fmax(high, at);
        reach += half * fabs(axis[k]);
    }
    return low > reach || high < -reach;
}

/* The separating axes of a triangle and a cube: the triangle's normal and its edges crossed with the cube's.
 * The cube's own axes are covered by the choice of cells. */
static bool touches(const double corner[3][3], const double middle[3], double half) {
    double v[3][3], edge[2][3], normal[3];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) v[i][k] = corner[i][k] - middle[k];
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 3; k++) edge[i][k] = v[i + 1][k] - v[0][k];
    cross3(edge[0], edge[1], normal);
    if (axis_parts(normal, v, half)) return false;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            double side[3], axis[3], unit[3] = {k == 0, k == 1, k == 2};
            for (int j = 0; j < 3; j++) side[j] = v[(i + 1) % 3][j] - v[i][j];
            cross3(unit, side, axis);
            if (axis_parts(axis, v, half)) return false;
        }
    return true;
}

static void wall_add(solid_grid *g, const solid_mesh *mesh, int64_t triangle) {
    double corner[3][3];
    int low[3], high[3];
    const double cell = (double)g->cell_m;
    for (int k = 0; k < 3; k++) {
        double from = INFINITY, to = -INFINITY;
        for (int i = 0; i < 3; i++) {
            corner[i][k] = (double)mesh->vertex[3 * (size_t)mesh->triangle[3 * triangle + i] + (size_t)k];
            from = fmin(from, corner[i][k]);
            to = fmax(to, corner[i][k]);
        }
        low[k] = (int)floor((from - (double)g->min[k]) / cell);
        high[k] = (int)floor((to - (double)g->min[k]) / cell);
    }
    for (int z = low[2]; z <= high[2]; z++)
        for (int y = low[1]; y <= high[1]; y++)
            for (int x = low[0]; x <= high[0]; x++) {
                const double middle[3] = {(double)g->min[0] + (x + 0.5) * cell,
                                          (double)g->min[1] + (y + 0.5) * cell,
                                          (double)g->min[2] + (z + 0.5) * cell};
                if (touches(corner, middle, cell / 2)) g->cell[cell_at(g, x, y, z)] = SOLID_WALL;
            }
}

/* ---- the flood ---- */
/* Floods across faces of cells from the first one, with a list of cells still to visit. */
static sherf_status flood(context *c, solid_grid *g) {
    size_t count = 1, room = 1 << 16;
    const size_t all = (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
    const size_t step[3] = {1, (size_t)g->size[0], (size_t)g->size[0] * (size_t)g->size[1]};
    uint32_t *list = mem_alloc(c, room, sizeof *list);
    if (!list) return SHERF_NO_MEMORY;
    list[0] = 0;
    g->cell[0] = SOLID_OUTSIDE;
    while (count) {
        const size_t at = list[--count];
        if (count + 6 > room) {
            uint32_t *more = mem_grow(c, list, count, 2 * room, sizeof *more);
            if (!more) break;
            list = more;
            room *= 2;
        }
        for (int k = 0; k < 3; k++) {
            const size_t place = at / step[k] % (size_t)g->size[k];
            const size_t next[2] = {place ? at - step[k] : all,
                                    place + 1 < (size_t)g->size[k] ? at + step[k] : all};
            for (int i = 0; i < 2; i++)
                if (next[i] < all && g->cell[next[i]] == SOLID_INSIDE) {
                    g->cell[next[i]] = SOLID_OUTSIDE;
                    list[count++] = (uint32_t)next[i];
                }
        }
    }
    mem_free(list);
    return count ? SHERF_NO_MEMORY : SHERF_OK;
}

/* ---- gaps ---- */
enum { SEALED = SOLID_INSIDE + 1, MARKED };

/* One layer: cells of kind `of` that share a face with a cell of kind `by` become `into`. */
static void layer(solid_grid *g, int by, int of, int into) {
    const size_t step[3] = {1, (size_t)g->size[0], (size_t)g->size[0] * (size_t)g->size[1]};
    const size_t all = step[2] * (size_t)g->size[2];
    for (int z = 1; z + 1 < g->size[2]; z++)
        for (int y = 1; y + 1 < g->size[1]; y++)
            for (int x = 1; x + 1 < g->size[0]; x++) {
                const size_t at = cell_at(g, x, y, z);
                for (int k = 0; k < 3 && g->cell[at] == of; k++)
                    if (g->cell[at - step[k]] == by || g->cell[at + step[k]] == by) g->cell[at] = MARKED;
            }
    for (size_t i = 0; i < all; i++)
        if (g->cell[i] == MARKED) g->cell[i] = (uint8_t)into;
}

/* For the flood, walls are `seal` cells thicker; afterwards it reclaims those cells that it borders on. */
static sherf_status flood_sealed(context *c, solid_grid *g, int seal) {
    const size_t all = (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
    for (int i = 0; i < seal; i++) layer(g, i ? SEALED : SOLID_WALL, SOLID_INSIDE, SEALED);
    const sherf_status status = flood(c, g);
    for (int i = 0; i < seal; i++) layer(g, SOLID_OUTSIDE, SEALED, SOLID_OUTSIDE);
    for (size_t i = 0; i < all; i++)
        if (g->cell[i] == SEALED) g->cell[i] = SOLID_INSIDE;
    return status;
}

sherf_status solid_grid_create(context *c, int meshes, const solid_mesh *mesh, float cell_m, int seal,
                               solid_grid *out) {
    *out = (solid_grid){0};
    if (seal < 0 || seal > SOLID_SEAL_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "gaps of %d cells: 0 to %d can be sealed", seal,
                       SOLID_SEAL_MAX);
    sherf_status status = lay_out(c, meshes, mesh, cell_m, seal, out);
    for (int i = 0; i < meshes && status == SHERF_OK; i++)
        for (int64_t t = 0; t < mesh[i].triangles; t++) wall_add(out, &mesh[i], t);
    if (status == SHERF_OK) status = flood_sealed(c, out, seal);
    if (status != SHERF_OK) solid_grid_free(out);
    return status;
}

/* ---- places ---- */
static bool cell_of(const solid_grid *g, const float place[3], int cell[3]) {
    for (int k = 0; k < 3; k++) {
        const float at = floorf((place[k] - g->min[k]) / g->cell_m);
        if (!(at >= 0 && at < (float)g->size[k])) return false;
        cell[k] = (int)at;
    }
    return true;
}

int solid_at(const solid_grid *g, const float place[3]) {
    int cell[3];
    return cell_of(g, place, cell) ? g->cell[cell_at(g, cell[0], cell[1], cell[2])] : SOLID_OUTSIDE;
}

/* The number of neighbouring cells of this kind. */
static int neighbours(const solid_grid *g, const int cell[3], int kind) {
    int n = 0;
    for (int i = 0; i < 27; i++) {
        const int at[3] = {cell[0] + i % 3 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i / 9 - 1};
        bool there = true;
        for (int k = 0; k < 3; k++) there &= at[k] >= 0 && at[k] < g->size[k];
        n += there ? g->cell[cell_at(g, at[0], at[1], at[2])] == kind : kind == SOLID_OUTSIDE;
    }
    return n;
}

bool solid_contains(const solid_grid *g, const float place[3]) {
    int cell[3];
    if (!cell_of(g, place, cell)) return false;
    const int kind = g->cell[cell_at(g, cell[0], cell[1], cell[2])];
    if (kind != SOLID_WALL) return kind == SOLID_INSIDE;
    return neighbours(g, cell, SOLID_INSIDE) > neighbours(g, cell, SOLID_OUTSIDE);
}

/* ---- points by area ---- */
/* Twice the area times the normal. */
static double triangle_cross(const solid_mesh *mesh, int64_t t, double out[3]) {
    double edge[2][3];
    const float *v[3];
    for (int i = 0; i < 3; i++) v[i] = mesh->vertex + 3 * (size_t)mesh->triangle[3 * t + i];
    for (int i = 0; i < 2; i++)
        for (int k = 0; k < 3; k++) edge[i][k] = (double)v[i + 1][k] - (double)v[0][k];
    cross3(edge[0], edge[1], out);
    return sqrt(dot3(out, out));
}

/* The triangle, counted through all meshes, at this share of the area. */
static int64_t find(const double *before, int64_t n, double at) {
    int64_t low = 0, high = n - 1;
    while (low < high) {
        const int64_t middle = (low + high) / 2;
        if (before[middle + 1] > at)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

static void place(const solid_mesh *mesh, int index, int64_t t, double u, double v, solid_point *out) {
    double normal[3];
    const double length = triangle_cross(mesh, t, normal), root = sqrt(u);
    *out = (solid_point){.mesh = index, .triangle = t};
    const double weight[3] = {1 - root, root * (1 - v), root * v};
    for (int i = 0; i < 3; i++) out->weight[i] = (float)weight[i];
    for (int k = 0; k < 3; k++) {
        double sum = 0;
        for (int i = 0; i < 3; i++)
            sum += weight[i] * (double)mesh->vertex[3 * (size_t)mesh->triangle[3 * t + i] + (size_t)k];
        out->position[k] = (float)sum;
        out->normal[k] = length > 0 ? (float)(normal[k] / length) : 0;
    }
}

sherf_status solid_points(context *c, const solid_grid *g, int meshes, const solid_mesh *mesh, uint64_t key,
                          int64_t count, solid_point *out, int64_t *found) {
    enum { TRIES = 100 };
    int64_t n = 0, at = 0;
    *found = 0;
    for (int i = 0; i < meshes; i++) n += mesh[i].triangles;
    double *before = mem_zero(c, (size_t)n + 1, sizeof *before), normal[3];
    if (!before) return SHERF_NO_MEMORY;
    for (int i = 0; i < meshes; i++)
        for (int64_t t = 0; t < mesh[i].triangles; t++, at++)
            before[at + 1] = before[at] + triangle_cross(&mesh[i], t, normal);
    for (int64_t k = 0; k < TRIES * count && *found < count && before[n] > 0; k++) {
        int64_t t = find(before, n, random_uniform(key, 3 * (uint64_t)k) * before[n]);
        int at_mesh = 0, cell[3];
        while (t >= mesh[at_mesh].triangles) t -= mesh[at_mesh++].triangles;
        solid_point *p = &out[*found];
        place(&mesh[at_mesh], at_mesh, t, random_uniform(key, 3 * (uint64_t)k + 1),
              random_uniform(key, 3 * (uint64_t)k + 2), p);
        *found += cell_of(g, p->position, cell) && neighbours(g, cell, SOLID_OUTSIDE) > 0;
    }
    mem_free(before);
    return SHERF_OK;
}
