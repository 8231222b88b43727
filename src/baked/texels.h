/* texels: every other texel of an atlas; the values of the rest are means of theirs. */
#ifndef SHERF_TEXELS_H
#define SHERF_TEXELS_H

#include "baked/atlas.h"

/* The texels that are computed: those in even rows and columns, and those that lack such a neighbour on the
 * same piece of the surface. */
typedef struct {
    int64_t count;
    int32_t *texel; /* count, of the atlas's */
    int32_t *from;  /* texels x 4: indices below count of the texels whose mean it is; -1 after the last. Only
                       its own if it is one of them */
} texel_mesh;
/* positions: texels x 3; distances tell pieces of the surface apart. */
sherf_status texel_mesh_make(context *c, const atlas *a, const float *positions, texel_mesh *out);
void texel_mesh_free(texel_mesh *mesh);
/* From values of the computed texels (count x 3) to those of all (texels x 3). */
void texel_mesh_spread(const atlas *a, const texel_mesh *mesh, const float *some, float *all);

#endif
