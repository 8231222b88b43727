/* Marching cubes with derived tables instead of listed ones. The 8 bits of a cube's case say which corners
 * are solid and which edges are crossed. On each face the crossed edges are joined in pairs such that every
 * run of solid corners is cut off separately; the cube on the other side of the face joins them in the same
 * way, so the surface closes. A cube's joints form loops, with one vertex on each edge; loops are cut into
 * triangles by diagonals that do not lie in a face, since a neighbour might have the same one. So every edge
 * of the surface has exactly two triangles, and the triangles round a vertex (one loop in each of the four
 * cubes at its grid edge) form one fan. */
#include "scene/cubes.h"

#include <math.h>
#include <string.h>

void surface_free(surface *s) {
    mem_free(s->position);
    mem_free(s->normal);
    mem_free(s->triangle);
    *s = (surface){0};
}

void cubes_grid_free(cubes_grid *g) {
    mem_free(g->value);
    *g = (cubes_grid){0};
}

enum { CASES = 256, LOOP_MAX = 12, CASE_TRIANGLES_MAX = 10 };

typedef struct {
    uint8_t count[CASES];
    uint8_t edge[CASES][3 * CASE_TRIANGLES_MAX];
} cube_table;

/* Corner i lies at (i & 1, i >> 1 & 1, i >> 2 & 1). Edge 4 a + k runs along axis a. */
static const uint8_t edge_corner[12][2] = {{0, 1}, {2, 3}, {4, 5}, {6, 7}, {0, 2}, {1, 3},
                                           {4, 6}, {5, 7}, {0, 4}, {1, 5}, {2, 6}, {3, 7}};
/* Corners of each face, counter-clockwise seen from outside: -x +x -y +y -z +z. */
static const uint8_t face_corner[6][4] = {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4},
                                          {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}};

static int edge_between(int a, int b) {
    for (int e = 0; e < 12; e++)
        if ((edge_corner[e][0] == a && edge_corner[e][1] == b) ||
            (edge_corner[e][0] == b && edge_corner[e][1] == a))
            return e;
    return -1;
}

/* next[e]: the crossed edge that follows e on its loop, or -1. */
static void join_edges(int bits, int next[12]) {
    for (int e = 0; e < 12; e++) next[e] = -1;
    for (int f = 0; f < 6; f++)
        for (int k = 0; k < 4; k++) { /* a run of solid corners begins after edge k, k + 1 */
            const uint8_t *corner = face_corner[f];
            if (bits >> corner[k] & 1 || !(bits >> corner[(k + 1) % 4] & 1)) continue;
            int end = k + 1;
            while (bits >> corner[(end + 1) % 4] & 1) end++;
            next[edge_between(corner[k], corner[(k + 1) % 4])] =
                edge_between(corner[end % 4], corner[(end + 1) % 4]);
        }
}

static bool on_one_face(int e, int f) {
    for (int face = 0; face < 6; face++) {
        int found = 0;
        for (int k = 0; k < 4; k++) {
            int edge = edge_between(face_corner[face][k], face_corner[face][(k + 1) % 4]);
            found += edge == e || edge == f;
        }
        if (found == 2) return true;
    }
    return false;
}

/* Triangles of the loop's part from i to j, for the chord i, j; false: none is valid. */
static bool cut_loop(const int *loop, int n, int i, int j, cube_table *t, int bits) {
    if (j - i < 2) return true;
    int count = t->count[bits];
    for (int k = i + 1; k < j; k++) {
        if (k - i > 1 && on_one_face(loop[i], loop[k])) continue;
        if (j - k > 1 && on_one_face(loop[k], loop[j])) continue;
        t->count[bits] = (uint8_t)count;
        if (!cut_loop(loop, n, i, k, t, bits) || !cut_loop(loop, n, k, j, t, bits)) continue;
        uint8_t *to = t->edge[bits] + 3 * t->count[bits]++;
        to[0] = (uint8_t)loop[i], to[1] = (uint8_t)loop[k], to[2] = (uint8_t)loop[j];
        return true;
    }
    t->count[bits] = (uint8_t)count;
    return false;
}

/* False would be our own bug; the tests run all cases. */
static bool table_make(cube_table *t) {
    bool good = true;
    memset(t, 0, sizeof *t);
    for (int bits = 0; bits < CASES; bits++) {
        int next[12];
        join_edges(bits, next);
        for (int e = 0; e < 12; e++) {
            int loop[LOOP_MAX], n = 0;
            for (int at = e; next[at] >= 0;) {
                int following = next[at];
                loop[n++] = at;
                next[at] = -1;
                at = following;
            }
            if (n) good = cut_loop(loop, n, 0, n - 1, t, bits) && good;
        }
    }
    return good;
}

/* ---- the surface ---- */
typedef struct {
    const cubes_grid *g;
    float level;
    cube_table table;
    uint32_t
        *vertex[2][3]; /* by layer z, z + 1: number of the vertex on the edge along an axis from (x, y) */
    surface *s;
    size_t vertex_room, triangle_room;
} march;

static bool solid(const march *state, size_t at) {
    return state->g->value[at] >= state->level;
}

/* The vertex between grid points p and q = p + 1 along the axis. */
static sherf_status add_vertex(context *c, march *state, const int p[3], int axis, uint32_t *number) {
    enum { VERTICES_MAX = 1 << 28 };
    const cubes_grid *g = state->g;
    surface *s = state->s;
    if ((size_t)s->vertices == state->vertex_room) {
        size_t room = state->vertex_room ? state->vertex_room + state->vertex_room / 2 : 1 << 14;
        if (room > VERTICES_MAX)
            return failure(c, SHERF_BAD_ARGUMENT, "marching cubes: the surface is too large");
        float *grown = mem_grow(c, s->position, state->vertex_room, room, 3 * sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        s->position = grown;
        state->vertex_room = room;
    }
    int q[3] = {p[0], p[1], p[2]};
    q[axis]++;
    float a = g->value[cubes_at(g, p[0], p[1], p[2])], b = g->value[cubes_at(g, q[0], q[1], q[2])];
    float t = (state->level - a) / (b - a); /* a and b are on opposite sides of the level */
    t = fminf(fmaxf(t, 0.02f), 0.98f);      /* vertices of neighbouring edges stay apart */
    float *x = s->position + 3 * s->vertices;
    for (int k = 0; k < 3; k++) x[k] = g->min[k] + g->step_m * ((float)p[k] + (k == axis ? t : 0));
    *number = (uint32_t)s->vertices++;
    return SHERF_OK;
}

/* Adds vertices on the edges that begin in layer z; those along z are stored with the layer where they begin.
 */
static sherf_status march_edges(context *c, march *state, int z) {
    const cubes_grid *g = state->g;
    sherf_status status = SHERF_OK;
    for (int y = 0; y < g->size[1] && status == SHERF_OK; y++)
        for (int x = 0; x < g->size[0] && status == SHERF_OK; x++) {
            const int p[3] = {x, y, z};
            const size_t at = cubes_at(g, x, y, z);
            const size_t beyond[3] = {at + 1, at + (size_t)g->size[0],
                                      at + (size_t)g->size[0] * (size_t)g->size[1]};
            for (int a = 0; a < 3 && status == SHERF_OK; a++)
                if (p[a] + 1 < g->size[a] && solid(state, at) != solid(state, beyond[a]))
                    status = add_vertex(c, state, p, a,
                                        &state->vertex[z & 1][a][(size_t)y * (size_t)g->size[0] + (size_t)x]);
        }
    return status;
}

static sherf_status march_cubes(context *c, march *state, int z) {
    const cubes_grid *g = state->g;
    surface *s = state->s;
    for (int y = 0; y + 1 < g->size[1]; y++)
        for (int x = 0; x + 1 < g->size[0]; x++) {
            int bits = 0;
            for (int k = 0; k < 8; k++)
                bits |= solid(state, cubes_at(g, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2))) << k;
            int count = state->table.count[bits];
            if (!count) continue;
            if ((size_t)(s->triangles + count) > state->triangle_room) {
                size_t room =
                    state->triangle_room ? state->triangle_room + state->triangle_room / 2 : 1 << 15;
                uint32_t *grown = mem_grow(c, s->triangle, state->triangle_room, room, 3 * sizeof *grown);
                if (!grown) return SHERF_NO_MEMORY;
                s->triangle = grown;
                state->triangle_room = room;
            }
            for (int k = 0; k < 3 * count; k++) {
                int e = state->table.edge[bits][k], from = edge_corner[e][0];
                size_t row = (size_t)(y + (from >> 1 & 1));
                s->triangle[3 * s->triangles + k] =
                    state->vertex[(z + (from >> 2)) & 1][e / 4]
                                 [row * (size_t)g->size[0] + (size_t)(x + (from & 1))];
            }
            s->triangles += count;
        }
    return SHERF_OK;
}

sherf_status cubes_surface(context *c, const cubes_grid *g, float level, surface *out) {
    *out = (surface){0};
    march *state = mem_zero(c, 1, sizeof *state);
    if (!state) return SHERF_NO_MEMORY;
    state->g = g;
    state->level = level;
    state->s = out;
    sherf_status status =
        table_make(&state->table) ? SHERF_OK : failure(c, SHERF_UNSUPPORTED, "marching cubes");
    for (int i = 0; i < 6 && status == SHERF_OK; i++) {
        state->vertex[i / 3][i % 3] = mem_alloc(c, (size_t)g->size[0] * (size_t)g->size[1], sizeof(uint32_t));
        if (!state->vertex[i / 3][i % 3]) status = SHERF_NO_MEMORY;
    }
    for (int z = 0; z < g->size[2] && status == SHERF_OK; z++) {
        status = march_edges(c, state, z);
        if (z && status == SHERF_OK) status = march_cubes(c, state, z - 1);
    }
    for (int i = 0; i < 6; i++) mem_free(state->vertex[i / 3][i % 3]);
    mem_free(state);
    if (status != SHERF_OK) surface_free(out);
    return status;
}
