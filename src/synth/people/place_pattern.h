/* place_pattern: procedural textures for the surroundings of made people. */
#ifndef SHERF_PLACE_PATTERN_H
#define SHERF_PLACE_PATTERN_H

#include "synth/trace/trace.h"

typedef enum {
    PATTERN_PLASTER, /* one colour, faint stains */
    PATTERN_PLANKS,  /* along v */
    PATTERN_TILES,
    PATTERN_BRICKS,
    PATTERN_SPECKS, /* carpet, asphalt, gravel */
    PATTERN_GRASS,
    PATTERN_STRIPES,
    PATTERN_CHECKS,
    PATTERN_WAVES,  /* warped bands: marble, camouflage, paintings */
    PATTERN_BLOCKS, /* rectangles of many colours, like posters and shop fronts */
    PATTERN_BOOKS,  /* four rows of spines */
    PATTERN_LEAVES, /* with holes: leaves on a transparent ground */
    PATTERN_VIEW,   /* from a window: sky above, green below */
    PATTERN_KINDS
} place_pattern;

/* Value noise on a lattice of `cells` on the unit square, periodic; 0 to 1. */
float place_noise(uint64_t key, int cells, float u, float v);
/* Its octaves, each twice as fine and half as strong; 0 to 1. */
float place_clouds(uint64_t key, int cells, int octaves, float u, float v);

enum { PATTERN_COLORS = 3 };
/* A picture of side x side texels that tiles seamlessly; the same key gives the same picture. color: sRGB, 0
 * to 1: the main one, a second, and joints or details. */
sherf_status place_pattern_create(context *c, place_pattern pattern, const float color[PATTERN_COLORS][3],
                                  uint64_t key, int side, trace_texture **out);

#endif
