/* atlas: the surface cut into charts, laid flat in one square picture. */
#ifndef SHERF_ATLAS_H
#define SHERF_ATLAS_H

#include "baked/baked.h"

enum { ATLAS_SIDE_MIN = 64, ATLAS_SIDE_MAX = 4096 };

typedef struct {
    int side_px, charts;
    int64_t corners;    /* vertices, once for each chart they are in */
    uint32_t *vertex;   /* corners: of the surface */
    float *uv;          /* corners x 2, in texels from the upper left corner; texel (i, j) is at its centre */
    uint32_t *triangle; /* T x 3: corners, triangles in the surface's order */
    /* the texels that belong to a triangle, row by row */
    int64_t texels;
    int32_t *texel;     /* row * side_px + column */
    int32_t *face;      /* triangle */
    float *barycentric; /* texels x 2: of its second and third corner */
} atlas;
/* Charts are connected, face one direction within 60 degrees or so and do not overlap. */
sherf_status atlas_make(context *c, const surface *s, int side_px, atlas *out);
void atlas_free(atlas *a);
/* The picture (side x side x 3 bytes) from its texels' colours; texels between charts take their neighbours'.
 */
sherf_status atlas_paint(context *c, const atlas *a, const float *rgb, uint8_t *picture);

#endif
