/* sparse_levels: the active voxels and sparse convolution rules of a volume's levels, each half the size of
 * the one before, from its occupied voxels (network.md 3). */
#ifndef SHERF_SPARSE_LEVELS_H
#define SHERF_SPARSE_LEVELS_H

#include "base/base.h"

typedef struct {
    int size[3]; /* z y x */
    int64_t voxels;
    int32_t *grid;      /* size z*y*x: row or -1 */
    int32_t *rule;      /* [voxels, 27] submanifold */
    int32_t *down_rule; /* [next level's voxels, 27] stride 2 from this level; NULL at the last */
} sparse_level;

/* Linear number of the voxel z, y, x. */
static inline int64_t sparse_voxel(const sparse_level *level, const int32_t zyx[3]) {
    return ((int64_t)zyx[0] * level->size[1] + zyx[1]) * level->size[2] + zyx[2];
}
/* Fills the levels, whose sizes are given, from the occupied voxels [V, 3] of level 0. The first `ruled`
 * levels get a `rule`. Call sparse_levels_free in any case. */
sherf_status sparse_levels_create(context *c, sparse_level *level, int levels, int ruled, int vertices,
                                  const int32_t *vertex_zyx);
void sparse_levels_free(sparse_level *level, int levels);

#endif
