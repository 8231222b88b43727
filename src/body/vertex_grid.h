/* A vertex grid's internals, shared by its search (vertex_grid.c) and its voxels' lists (vertex_list.c). */
#ifndef SHERF_VERTEX_GRID_H
#define SHERF_VERTEX_GRID_H

#include "body/body.h"

typedef struct {
    float d2, reach; /* best squared distance, and a little more than its root */
    int32_t index;   /* INT32_MAX: none */
} nearest_state;
typedef void search_function(const vertex_grid *g, const float p[3], nearest_state *best);

/* Sixteen vertices of a voxel's list; unused lanes are too far away to count. */
typedef struct {
    float x[16], y[16], z[16];
    int32_t index[16];
} vertex_block;
/* The best vertex in `blocks` blocks, if it is better than best. */
typedef void list_function(const vertex_block *block, int blocks, const float p[3], nearest_state *best);

enum {
    LIST_BLOCKS_MAX = 63, /* longer lists are not stored: LIST_NONE, and rings are searched */
    LIST_NONE = 1,
    SLAB_BLOCKS = 4096,
    SLABS_MAX = 1024
};

struct vertex_grid {
    int32_t vertices, cells[3];
    float min[3], cell_m, per_m; /* per_m = 1 / cell_m */
    float slack_m;               /* bounds the rounding error of a cell's place */
    float limit_d2;              /* the largest squared distance that counts */
    float *x, *y, *z;            /* by cell, padded with 16 values */
    int32_t *index;              /* their vertices */
    int32_t *start;              /* cells + 1 */
    float *vertex;               /* V x 3, as given */
    search_function *search;
    /* vertex_grid_refine */
    vertex_shell shell;
    float shell_per_m, reach_m;
    int32_t *entry; /* by voxel: 0 beyond reach, LIST_NONE, or number of the first block << 6 | blocks */
    vertex_block *slab[SLABS_MAX]; /* block n is slab[n / SLAB_BLOCKS][n % SLAB_BLOCKS] */
    int slabs;
    list_function *list;
};

/* Monotone in x, so that a range of x is a range of cells. NaN gives 0. */
static inline int vertex_grid_cell(const vertex_grid *g, int axis, float x) {
    float f = (x - g->min[axis]) * g->per_m;
    int last = g->cells[axis] - 1;
    return !(f > 0) ? 0 : f >= (float)last ? last : (int)f;
}

static inline int vertex_shell_cell(const vertex_grid *g, int axis, float x) {
    float f = (x - g->shell.min[axis]) * g->shell_per_m;
    int last = g->shell.cells[axis] - 1;
    return !(f > 0) ? 0 : f >= (float)last ? last : (int)f;
}

list_function *vertex_list_best(void);

#endif
