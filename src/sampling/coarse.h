/* coarse: frames whose rays go through what is known of the avatar in cells of canonical space, and query the
 * model only for the samples that weigh. */
#ifndef SHERF_COARSE_H
#define SHERF_COARSE_H

#include <math.h>

#include "sampling/sampling.h"

/* What a model answers in the middles of canonical cells, for any pose and camera: where it weighs little in
 * a frame, that is close enough. value: [z][y][x] raw density, red, green, blue; owned. NULL: none. */
typedef struct {
    int cells[3];
    float min[3], per_m;
    float (*value)[4];
} coarse_field;

/* The coarse field's answer at a canonical place, trilinear between middles; the outermost ones' beyond them.
 */
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

/* The samples near the body that have density in it and are not hidden, with its answers; `queried`: those of
 * them that the model is to answer instead. A frame is made of `all` by points_render. */
typedef struct {
    point_set *queried;
    point_set all;       /* without places: first and sample */
    float *rgb, *sigma;  /* of `all`: [P, 3], [P] */
    int32_t *queried_at; /* of `all`: place in `queried`, or one of the two below */
} coarse_points;
/* Where a sample weighs too little to be queried; where its neighbours' answers are to move it. */
enum { COARSE_KEPT = -1, COARSE_MOVED = -2 };
/* As points_create; free with coarse_points_free, whatever the answer. A ray queries its heaviest samples, so
 * that the others weigh little, each and together; where pixels are close, every other one of them, as
 * on a chequerboard over columns, rows and depths. */
sherf_status coarse_points_create(context *c, const body_model *body, const posed_body *target,
                                  const ray_bundle *rays, int samples, const posed_body *observation,
                                  const sherf_camera *observation_camera, const coarse_field *coarse,
                                  coarse_points *out);
/* The model's answers to `queried`, rgb [P, 3] and raw density [P], into `all`; what the
 * chequerboard left out is moved as its neighbours are. */
sherf_status coarse_points_answer(context *c, const ray_bundle *rays, const float *rgb, const float *sigma,
                                  coarse_points *points);
void coarse_points_free(coarse_points *p);

#endif
