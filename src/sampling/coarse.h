/* coarse: frames whose rays go through a coarse field of the avatar in cells of canonical space, and query
 * the model only for samples of large weight. */
#ifndef SHERF_COARSE_H
#define SHERF_COARSE_H

#include <math.h>

#include "sampling/sampling.h"

/* A model's density and colour in the middles of canonical cells, for any pose and camera. It is close enough
 * where a sample has little weight in a frame. value: [z][y][x] raw density, red, green, blue; owned. NULL:
 * none. */
typedef struct {
    int cells[3];
    float min[3], per_m;
    float (*value)[4];
} coarse_field;

/* The coarse field's value at a canonical place, trilinear between cell middles, constant beyond the
 * outermost ones. */
static inline void coarse_at(const coarse_field *f, const float canonical[3], float out[4]) {
    typedef float four __attribute__((vector_size(16), may_alias));
    float part[3];
    size_t low[3];
    for (int k = 0; k < 3; k++) {
        const float v = (canonical[k] - f->min[k]) * f->per_m - 0.5f, last = (float)(f->cells[k] - 2);
        const float cell = v > 0 ? v < last ? floorf(v) : last : 0;
        part[k] = v - cell < 0 ? 0 : v - cell > 1 ? 1 : v - cell;
        low[k] = (size_t)cell;
    }
    const size_t row = (size_t)f->cells[0], layer = row * (size_t)f->cells[1];
    const four *at = (const four *)(f->value + low[2] * layer + low[1] * row + low[0]);
    const float x = part[0], y = part[1], z = part[2];
    const four near = (at[0] * (1 - x) + at[1] * x) * (1 - y) + (at[row] * (1 - x) + at[row + 1] * x) * y;
    at += layer;
    const four far = (at[0] * (1 - x) + at[1] * x) * (1 - y) + (at[row] * (1 - x) + at[row + 1] * x) * y;
    *(four *)out = near * (1 - z) + far * z;
}

/* The samples near the body that have density in the coarse field and are not hidden, with its values;
 * `queried`: those to query the model for instead. points_render makes a frame of `all`. */
typedef struct {
    point_set *queried;
    point_set all;       /* without places: first and sample */
    float *rgb, *sigma;  /* of `all`: [P, 3], [P] */
    int32_t *queried_at; /* of `all`: index in `queried`, or one of the two below */
} coarse_points;
/* The sample's weight is too small to query it; its neighbours' results correct it. */
enum { COARSE_KEPT = -1, COARSE_MOVED = -2 };
/* As points_create; free with coarse_points_free, even after an error. A ray queries its samples of largest
 * weight, so that the others weigh little, each and together; where pixels are close, only every other one of
 * them, on a chequerboard over columns, rows and depths. pitch_m: of rays_pitch. */
sherf_status coarse_points_create(context *c, const body_model *body, const posed_body *target,
                                  const ray_bundle *rays, int samples, float pitch_m,
                                  const posed_body *observation, const sherf_camera *observation_camera,
                                  const coarse_field *coarse, coarse_points *out);
/* Writes the model's results for `queried`, rgb [P, 3] and raw density [P], into `all`; samples that the
 * chequerboard skipped are corrected as their neighbours were. */
sherf_status coarse_points_answer(context *c, const ray_bundle *rays, const float *rgb, const float *sigma,
                                  coarse_points *points);
void coarse_points_free(coarse_points *p);

#endif
