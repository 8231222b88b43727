/* splats: a surface as flat Gaussians lying on it. */
#ifndef SHERF_SPLATS_H
#define SHERF_SPLATS_H

#include "baked/baked.h"

typedef struct {
    int64_t count;
    int32_t *face;                  /* the triangle of each */
    float *barycentric;             /* count x 2: of its second and third corner */
    float *position, *normal, *rgb; /* count x 3 */
    float across_m, along_m;        /* standard deviations in the surface and along its normal */
    float opacity;
} splats;
enum { SPLATS_MAX = 10000000 };
/* Exactly `count` places spread evenly over the surface: none much nearer to another than its share of the
 * area allows. splats_place and others fill positions, normals and colours. */
sherf_status splats_make(context *c, const surface *s, int64_t count, splats *out);
/* Positions and normals from those of the surface's vertices. */
void splats_place(const surface *s, const float *position, const float *normal, splats *p);
void splats_free(splats *s);
/* Rotation w x y z that turns z to the unit normal. */
void splat_rotation(const float normal[3], float out[4]);

#endif
