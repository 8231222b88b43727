/* The exact nearest vertex by the cells of a uniform grid, as in vertex_grid.c: squared distances in float32
 * without fused operations, the lowest index on a tie, so that both give the same vertex. A search visits
 * rows of cells (y, z) in rings around the point's own and stops when a ring is farther than the best vertex
 * so far. For files compiled without fused operations. */
#ifndef SHERF_CUDA_CELLS_H
#define SHERF_CUDA_CELLS_H

#include "sampling/cuda/frame.h"

namespace cuda_backend {

/* Monotone in x, so that a range of x is a range of cells. NaN gives 0. */
__device__ inline int cell_of(const cells_head &h, int axis, float x) {
    const float f = (x - h.min[axis]) * h.per_m;
    const int last = h.cells[axis] - 1;
    return !(f > 0) ? 0 : f >= (float)last ? last : (int)f;
}

__device__ inline int64_t cell_number(const cells_head &h, int x, int y, int z) {
    return ((int64_t)z * h.cells[1] + y) * h.cells[0] + x;
}

/* Whether a vertex may be within BODY_SHELL_M of p. */
__device__ inline bool cell_is_near(const vertex_cells &g, const float p[3]) {
    const cells_head &h = *g.head;
    int cell[3];
    for (int k = 0; k < 3; k++) {
        const float f = (p[k] - h.min[k]) * h.per_m;
        if (!(f >= 0 && f < (float)h.cells[k])) return false;
        cell[k] = (int)f;
    }
    return g.near[cell_number(h, cell[0], cell[1], cell[2])] != 0;
}

struct nearest_search {
    const vertex_cells &g;
    const cells_head &h;
    float p[3], d2, reach; /* best squared distance, and a little more than its root */
    int32_t index;

    __device__ nearest_search(const vertex_cells &cells, const float at[3], float limit_d2)
        : g(cells), h(*cells.head), p{at[0], at[1], at[2]}, d2(limit_d2), index(INT32_MAX) {
        reach = sqrtf(limit_d2) * 1.00001f + h.slack_m;
    }

    __device__ void take(float x, float y, float z, int32_t vertex) {
        const float dx = x - p[0], dy = y - p[1], dz = z - p[2];
        const float found = (dx * dx + dy * dy) + dz * dz;
        if (found < d2 || (found == d2 && vertex < index)) {
            if (found < d2) reach = sqrtf(found) * 1.00001f + h.slack_m;
            d2 = found;
            index = vertex;
        }
    }

    /* Lower bound of the distance to cell `cell` along an axis, 0 inside. */
    __device__ float slab(int axis, int cell) const {
        const float low = h.min[axis] + (float)cell * h.cell_m, x = p[axis];
        const float high = h.min[axis] + (float)(cell + 1) * h.cell_m;
        const float d = (x < low ? low - x : x > high ? x - high : 0) * 0.99999f - h.slack_m;
        return d > 0 ? d : 0;
    }

    __device__ void row(int y, int z, float away2) {
        if (away2 > d2) return;
        const int32_t *start = g.start + cell_number(h, 0, y, z);
        const int32_t end = start[cell_of(h, 0, p[0] + reach) + 1];
        for (int32_t i = start[cell_of(h, 0, p[0] - reach)]; i < end; i++)
            take(g.x[i], g.y[i], g.z[i], g.index[i]);
    }

    __device__ void rings() {
        const int ny = h.cells[1], nz = h.cells[2], cy = cell_of(h, 1, p[1]), cz = cell_of(h, 2, p[2]);
        const float own_y = slab(1, cy), own_z = slab(2, cz);
        row(cy, cz, own_y * own_y + own_z * own_z);
        for (int k = 1;; k++) {
            const int y0 = cy - k, y1 = cy + k, z0 = cz - k, z1 = cz + k;
            const float left = y0 >= 0 ? slab(1, y0) : INFINITY, right = y1 < ny ? slab(1, y1) : INFINITY;
            const float below = z0 >= 0 ? slab(2, z0) : INFINITY, above = z1 < nz ? slab(2, z1) : INFINITY;
            const float d_min = fminf(fminf(left, right), fminf(below, above));
            if (d_min == INFINITY || d_min * d_min > d2) return;
            for (int z = z0 < 0 ? 0 : z0; z <= z1 && z < nz; z++) {
                const bool edge = z == z0 || z == z1;
                float dz = edge ? z == z0 ? below : above : slab(2, z);
                dz *= dz;
                if (dz > d2) continue;
                if (y0 >= 0) row(y0, z, dz + left * left);
                for (int y = y0 < 0 ? 0 : y0 + 1; edge && y < y1 && y < ny; y++) {
                    const float dy = slab(1, y);
                    row(y, z, dz + dy * dy);
                }
                if (y1 < ny) row(y1, z, dz + right * right);
            }
        }
    }
};

/* The nearest vertex with a squared distance of at most limit_d2, or -1. guess: a vertex that may be near, or
 * -1. */
__device__ inline int32_t nearest_vertex(const vertex_cells &g, const float p[3], float limit_d2,
                                         int32_t guess) {
    nearest_search s(g, p, limit_d2);
    if (guess >= 0) s.take(g.vertex[3 * guess], g.vertex[3 * guess + 1], g.vertex[3 * guess + 2], guess);
    s.rings();
    return s.index == INT32_MAX ? -1 : s.index;
}

} // namespace cuda_backend
#endif
