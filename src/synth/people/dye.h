/* dye: new colours and patterns for a garment's texture, so that no two people wear the same. Patterns are
 * defined in space (at a texel's place on the base mesh), so they continue across seams. */
#ifndef SHERF_DYE_H
#define SHERF_DYE_H

#include "io/image.h"
#include "synth/people/proxy.h"

enum { DYE_PARTS = 8, DYE_NONE = 255 };

/* Texels of one kind: the texture's islands above or below the waist with one colour. */
typedef struct {
    float share;    /* of the texels that are used */
    float color[3]; /* the median one, sRGB */
    float luminance;
    float low[3], high[3]; /* its bounds, metres, on the base mesh */
} dye_part;

typedef struct {
    int width, height, parts;
    uint8_t *part;          /* H x W: DYE_NONE if no face is near */
    float *place;           /* H x W x 3, metres */
    dye_part of[DYE_PARTS]; /* in descending order of size */
} dye_map;

/* vertex: V x 3, the proxy on the base mesh. If split is set, parts above and below waist_m are separate.
 * texture: RGBA; texels that no face uses take the colours of their neighbours. */
sherf_status dye_map_create(context *c, const proxy *p, const float *vertex, bool split, float waist_m,
                            image_u8 *texture, dye_map **out);
void dye_map_free(dye_map *map);

typedef enum {
    DYE_KEEP, /* unchanged, but brighter or darker by value */
    DYE_PLAIN,
    DYE_BANDS,   /* horizontal */
    DYE_STRIPES, /* vertical */
    DYE_CHECKS,
    DYE_PLAID,
    DYE_DOTS,
    DYE_GRADIENT, /* from top to bottom */
    DYE_HALVES,   /* two colours, left and right or above and below */
    DYE_CLOUDS,   /* soft noise of three colours */
    DYE_SPECKS,   /* blocks of noise */
    DYE_PATTERNS
} dye_pattern;

typedef struct {
    dye_pattern pattern;
    float color[3][3]; /* sRGB, 0 to 1 */
    float scale_m;     /* width of stripes, size of cells */
    float ratio;       /* 0.1 to 0.9: the second colour's share of a stripe or cell */
    float value;       /* DYE_KEEP: factor of brightness */
    float hue_turn;    /* DYE_KEEP: fraction of a full turn */
    float detail;      /* 0 to 1: how much of folds and seams remains */
    uint64_t key;
} dye_recipe;

/* Cuts the garment off below legs_m, and beyond arms_m from the middle. */
typedef struct {
    float legs_m, arms_m; /* -INFINITY and INFINITY: all of it stays */
} dye_cut;

/* One recipe for each part. out: RGBA of the same size, to be freed with mem_free(out->data). */
sherf_status dye_apply(context *c, const dye_map *map, const image_u8 *texture, const dye_recipe *recipe,
                       const dye_cut *cut, image_u8 *out);
/* The pattern alone: shares of the second and third colour at a place; they sum to at most 1. */
void dye_shares(const dye_recipe *r, const dye_part *part, const float place[3], float *second, float *third);

#endif
