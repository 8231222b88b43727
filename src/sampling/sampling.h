/* sampling: the samples of a frame's rays that lie near the body, and room for frames. */
#ifndef SHERF_SAMPLING_H
#define SHERF_SAMPLING_H

#include "scene/scene.h"

#ifdef __cplusplus /* CUDA's sources */
extern "C" {
#endif

/* ---- the samples that the network is queried for (network.md: Rays and points 2, 3) ---- */
typedef struct {
    int64_t count, rays;
    int samples;
    int32_t *first;             /* rays + 1: the points of ray n are [first[n], first[n + 1]) */
    int32_t *ray;               /* P, row-major pixel */
    int32_t *sample;            /* P, 0 .. samples-1 */
    float *canonical;           /* P x 3 */
    float *direction_canonical; /* P x 3, not normalised */
    float
        *observed_px; /* P x 2: projection into the observation camera; NULL when no observation was given */
    float *observation_world; /* P x 3 before that projection; only when requested */
    int32_t *nearest;         /* P, target vertex; only when requested (keep_stages) */
    const ray_bundle *on;     /* the rays, which outlive the set; NULL: the points lie on none */
    float *depth;             /* P, where they are not the rays' even ones; else NULL */
    float last_way;           /* with `depth`: the distance behind a ray's last point; 0: to the box's end */
} point_set;
/* The raw density of the samples of a ray that are not kept; their colour is 0. */
#define SIGMA_EMPTY -80.0f
/* Occupancy of canonical space by cells. A set bit marks a cell known to be empty: bit x % 32 of bit[(z *
 * cells[1] + y) * words + x / 32]. Without bits nothing is known. */
typedef struct {
    int cells[3], words;
    float min[3], per_m;
    uint32_t *bit;
} occupancy_grid;
HOST_AND_DEVICE static inline bool cell_is_empty(const occupancy_grid *e, const float canonical[3]) {
    int cell[3];
    for (int k = 0; k < 3; k++) {
        const float v = (canonical[k] - e->min[k]) * e->per_m;
        if (!(v >= 0 && v < (float)e->cells[k])) return false;
        cell[k] = (int)v;
    }
    const size_t row = (size_t)cell[2] * (size_t)e->cells[1] + (size_t)cell[1];
    return e->bit[row * (size_t)e->words + (size_t)cell[0] / 32] >> (cell[0] % 32) & 1;
}

enum { POINT_SAMPLES_MAX = 4096 }; /* of a ray */
/* Exactly the samples whose nearest target vertex is closer than BODY_SHELL_M, without those in cells that
 * `empty` (or NULL) marks, in ray-major, then depth order. Samples far from the body are not visited.
 * observation and observation_camera may both be NULL. keep_stages: fills the stage arrays, for tests. */
sherf_status points_create(context *c, const body_model *body, const posed_body *target,
                           const ray_bundle *rays, int samples, const posed_body *observation,
                           const sherf_camera *observation_camera, const occupancy_grid *empty,
                           bool keep_stages, point_set **out);
/* Every sample of the rays that meet the box, near the body or not; fills only count, rays, first, ray,
 * sample and `on`. For fields that live in the world and do not use the body. */
sherf_status points_of_box(context *c, const ray_bundle *rays, int samples, point_set **out);
void points_free(point_set *p);
/* The depth of a point on a ray, and its place in the world. */
float point_depth(const point_set *p, int64_t i);
void point_world(const point_set *p, int64_t i, float out_world[3]);
/* Prepares a posed body for points_create, once for many pictures of one pose. Without it each call prepares
 * its own. */
sherf_status points_prepare(context *c, const body_model *body, posed_body *target);

/* Allocates the three pictures of a frame; keeps them if they have that size already. */
sherf_status frame_shape(context *c, int width, int height, sherf_frame *frame);

/* A frame made whole on a GPU, from a pose. */
typedef struct {
    int samples; /* depths a ray, */
    /* or up to this many where steps would be longer than step_max_m (rays_even_steps); 0: never more */
    int samples_max;
    float step_max_m;
    bool repair; /* rays_repair */
    float background[3];
    bool early_stop;             /* rays that are opaque skip the rest of their points */
    const occupancy_grid *empty; /* or NULL; all frames of an avatar that pass one pass the same */
} gpu_frame_options;

#ifdef __cplusplus
}
#endif
#endif
