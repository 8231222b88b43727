/* baked: an avatar as a surface or as splats, with colours and a skin; export/ writes them to files. The data
 * flow: density on a canonical grid (field.c), its level (level.c, solid.c) -> closed surface (scene/cubes.h,
 * surface.c) -> fewer triangles (reduce.c), skin (skin.c), atlas (atlas.c) or splats (splats.c), coloured by
 * short rays along the normals (bake.c). Spaces as in body/body.h: positions are _canonical until skin_pose
 * takes them to a posed body's world. */
#ifndef SHERF_BAKED_H
#define SHERF_BAKED_H

#include <math.h>

#include "avatar/avatar.h"
#include "scene/cubes.h"

enum { EXPORT_RESOLUTION_MIN = 16, EXPORT_RESOLUTION_MAX = 768, FIELD_POINTS_MAX = 200000000 };

/* ---- field.c, level.c, solid.c: the network's density in canonical space ---- */
/* Colour (n x 3) and raw density (n) at canonical points seen along canonical directions. Points that are
 * BODY_SHELL_M or more from every canonical vertex are empty: density SIGMA_EMPTY, colour 0. Directions are
 * used with their length, as in a frame, where it is about 1. */
sherf_status field_query(context *c, const sherf_avatar *a, const body_model *body, int64_t n,
                         const float *points_canonical, const float *directions_canonical, float *rgb,
                         float *sigma);
/* Density, max(0, sigma), over the canonical body's box, `resolution` cells along its longest side, with two
 * layers of empty points around. The body's core, 15 mm or more below its skin, counts as solid: its value is
 * negative, and the network is not queried there. */
sherf_status field_density(context *c, const sherf_avatar *a, const body_model *body, int resolution,
                           cubes_grid *out);
/* The density at which the surface's silhouettes match the frames': along the three axes, a column of the
 * grid should exceed it exactly where the column is at least half opaque. At least 1 per metre. */
sherf_status field_level(context *c, const cubes_grid *g, float *level);
/* Divides the densities by the local level of the surface, relative to `level`, so that the surface at
 * `level` has the frames' silhouettes in every direction. The local level is smooth over about 3 cm. */
sherf_status field_level_places(context *c, cubes_grid *g, float level);
/* Maps densities from 0 to infinity to 0 to 2 level, and the level to itself. Values are then nearly linear
 * between grid points, and blurring moves the surface little. */
static inline float field_saturate(float density, float level) {
    return 2 * level * density / (density + level);
}
static inline float field_desaturate(float saturated, float level) {
    return level * saturated / fmaxf(2 * level - saturated, 1e-3f * level);
}
/* Blurs with 1 2 1 along each axis; the grid's rim stays. */
void field_smooth(const context *c, cubes_grid *g);
/* Marks the points below `level` that are connected to the rim through such points; the rim itself becomes
 * empty. outside: zeroed, one byte a point. */
sherf_status field_flood(context *c, cubes_grid *g, float level, uint8_t *outside);
/* Smooths by 1 2 1 along each axis. Then points that cannot be reached from the rim through points below
 * `level` become solid, so that the surface has no cavities. */
sherf_status field_solidify(context *c, cubes_grid *g, float level);

/* ---- surface.c ---- */
/* Twice the triangle's area times its normal. */
void surface_cross(const surface *s, int64_t t, double out[3]);
/* Keeps the connected components whose area is at least `share` of the largest one's and that are not
 * cavities; *dropped (may be NULL): the number of components removed. Removes unused vertices. */
sherf_status surface_keep_large(context *c, surface *s, double share, int *dropped);
/* Unit normals of the vertices from the grid's gradient, downhill, where it is steep enough, else from the
 * triangles; those alone when g is NULL. */
sherf_status surface_normals(context *c, surface *s, const cubes_grid *g);
/* ---- reduce.c ---- */
/* Reduces to this many triangles, or as few as possible while the surface stays closed and manifold. Normals
 * are dropped. */
sherf_status surface_reduce(context *c, surface *s, int64_t triangles);

/* ---- bake.c ---- */
/* Colours (n x 3, 0 to 1) of places on the surface seen along their normals, as in a frame without detail. */
sherf_status bake_colors(context *c, const sherf_avatar *a, const body_model *body, int64_t n,
                         const float *positions_canonical, const float *normals_canonical, float *rgb);
/* Adds the observation's detail to colours of places on the surface. */
sherf_status bake_detail(context *c, const sherf_avatar *a, const body_model *body, int64_t n,
                         const float *positions_canonical, float *rgb);

#endif
