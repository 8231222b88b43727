/* tiles: queries points in the order of their rays, a tile at a time, and composites them into a frame
 * (network.md 6). */
#ifndef SHERF_TILES_H
#define SHERF_TILES_H

#include "sampling/sampling.h"

/* Points of a tile; every array over the points of a tile has this length, 64-byte aligned. */
enum { POINT_TILE = 64 };
typedef struct {
    float position[3][POINT_TILE] __attribute__((aligned(64))); /* canonical, metres */
    float direction[3][POINT_TILE];                             /* canonical, not normalised */
    float pixel[2][POINT_TILE];                                 /* in the observation's picture */
    float out[4][POINT_TILE];                                   /* red, green, blue, raw density */
    int count;                                                  /* of POINT_TILE; the others hold zeros */
} point_tile;

/* A field that is queried a tile at a time, on any thread. */
typedef struct {
    const void *self;
    void (*answer)(const void *self, point_tile *t, void *scratch); /* fills t->out */
    size_t scratch_bytes;                                           /* one per thread, 64-byte aligned */
    bool stops_early; /* frames may skip points behind opaque ones */
} tile_source;

/* Loads points into a tile: index[0 .. count), or those from `first` on. */
void point_tile_fill(const point_set *points, const int64_t *index, int64_t first, int count, point_tile *t);

/* rgb [P, 3] and raw density [P] of every point of the set. */
sherf_status tiles_run(context *c, const tile_source *source, const point_set *points, float *rgb,
                       float *sigma);

/* Colour, opacity and depth of one frame from rays and points; out as in sherf_frame, background RGB;
 * early_stop: rays that are opaque skip the rest of their points, where the source allows it. */
sherf_status tiles_render(context *c, const tile_source *source, const ray_bundle *rays,
                          const point_set *points, const float background[3], bool early_stop,
                          sherf_frame *frame);
/* The same for points whose rgb [P, 3] and raw density [P] are known. */
sherf_status points_render(context *c, const ray_bundle *rays, const point_set *points, const float *rgb,
                           const float *sigma, const float background[3], sherf_frame *frame);

#endif
