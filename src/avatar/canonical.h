/* An avatar queried at any canonical points, as for a frame's: the canonical body is a target whose
 * way to canonical space is the identity. */
#ifndef SHERF_CANONICAL_H
#define SHERF_CANONICAL_H

#include "avatar/avatar.h"

/* Where the observed picture shows `n` canonical points, pixels [n, 2]; nearest: each one's nearest canonical
 * vertex. */
void canonical_observe(const sherf_avatar *a, const body_model *body, int64_t n,
                       const float *points_canonical, const int32_t *nearest, float *observed_px);

/* Room for some points and their answers. The caller fills set.count, set.canonical, nearest and, where
 * colour matters (density does not look at them), set.direction_canonical, which begin as zeros. */
typedef struct {
    point_set set;
    int32_t *nearest;
    float *rgb, *sigma; /* [count, 3], [count] */
} canonical_batch;

enum { CANONICAL_BATCH = 1 << 16 }; /* a good number of points */
sherf_status canonical_batch_make(context *c, size_t points, canonical_batch *b);
void canonical_batch_free(canonical_batch *b);
sherf_status canonical_batch_run(context *c, const sherf_avatar *a, const body_model *body,
                                 canonical_batch *b);

#endif
