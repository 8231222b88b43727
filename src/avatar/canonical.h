/* Queries an avatar at any canonical points, as a frame does: the canonical body is a target pose whose map
 * to canonical space is the identity. */
#ifndef SHERF_CANONICAL_H
#define SHERF_CANONICAL_H

#include "avatar/avatar.h"

/* Pixels [n, 2] at which the observed picture shows `n` canonical points; nearest: each point's nearest
 * canonical vertex. */
void canonical_observe(const sherf_avatar *a, const body_model *body, int64_t n,
                       const float *points_canonical, const int32_t *nearest, float *observed_px);

/* Room for some points and the query's results. The caller fills set.count, set.canonical, nearest and, for
 * colour (density does not depend on them), set.direction_canonical. All begin as zeros. */
typedef struct {
    point_set set;
    int32_t *nearest;
    float *rgb, *sigma; /* [count, 3], [count] */
} canonical_batch;

enum { CANONICAL_BATCH = 1 << 16 }; /* a good batch size, in points */
sherf_status canonical_batch_make(context *c, size_t points, canonical_batch *b);
void canonical_batch_free(canonical_batch *b);
sherf_status canonical_batch_run(context *c, const sherf_avatar *a, const body_model *body,
                                 canonical_batch *b);

#endif
