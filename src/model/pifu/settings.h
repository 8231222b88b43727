/* settings of PIFu as a model, and what its files share: the crop of the picture that its filters read. */
#ifndef SHERF_PIFU_SETTINGS_H
#define SHERF_PIFU_SETTINGS_H

#include "model/field.h"
#include "model/pifu/pifu.h"

typedef struct {
    int stacks, width, color_width, hidden[PIFU_HIDDEN];
    int side_px;    /* of the crop */
    float z_gain;   /* factor of z'; 1 in the paper, larger where a network must learn quickly to use z' */
    int points;     /* points per step, and as many places */
    int resolution; /* cells of the cube along a side, when its surface is looked for: a power of two */
    int coarse;     /* the first, coarse resolution: cells whose eight corners agree are not refined */
} pifu_settings;
static inline const pifu_settings *pifu_settings_of(const model_config *config) {
    return (const pifu_settings *)config->own.bytes;
}

/* ---- crop.c ---- A square of the picture about the person, scaled so that the standing person would fill
 * 0.88 of it, or wider where arms or legs reach out. */
typedef struct {
    int side;                       /* pixels */
    float *image;                   /* side x side x 3, -1 to 1; owned */
    float left_px, top_px, side_px; /* from its first pixel's middle to its last one's, in the picture */
    float z_scale;                  /* z per depth over height */
    float root_z_m, height_m;       /* depth of the root; height of the person */
    float middle[3];                /* of the square at the root's depth, world */
} pifu_crop;
sherf_status pifu_crop_create(context *c, const body_model *body, const observation_geometry *g,
                              const pifu_settings *k, pifu_crop **out);
void pifu_crop_free(void *crop); /* NULL is fine */
/* Maps points of the world to uv (n x 2) and z (n) as in pifu.h. `in` (n): whether the point lies in the
 * square. */
void pifu_crop_place(const pifu_crop *crop, const sherf_camera *camera, int64_t n, const float *points_world,
                     float *uv, float *z, uint8_t *in);

/* ---- surface.c ---- */
enum { PIFU_VERTICES, PIFU_TRIANGLES, PIFU_COLORS, PIFU_KEPT };
/* The coloured surface of occupancy 0.5, into the three arrays of an avatar; one triangle without area where
 * nothing is inside. */
sherf_status pifu_surface(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                          kept_bank *out);
extern const field_kind pifu_field;

#endif
