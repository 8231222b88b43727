/* render: cameras, rays, the samples near the body, a rasteriser. */
#ifndef SHERF_RENDER_H
#define SHERF_RENDER_H

#include "body/body.h"

#ifdef __cplusplus /* CUDA's sources */
extern "C" {
#endif

/* ---- camera ---- */
/* uv = K (R x + T) / (z + 1e-5); uv is n x 2, depth (may be NULL) n. */
void camera_project(const sherf_camera *camera, int64_t n, const float *points_world, float *uv_px,
                    float *depth_m);
void camera_position(const sherf_camera *camera, float position_world[3]);
sherf_status
camera_check(context *c, const sherf_camera *camera); /* finite, K invertible, R a rotation, sizes in range */
/* SHERF_MISMATCH when no vertex of the posed body falls into the camera's picture, when all of it is smaller
 * than two pixels, or, with a mask (1 byte a pixel), when no vertex falls where it is not 0. */
sherf_status body_in_picture(context *c, const body_model *m, const posed_body *p, const sherf_camera *camera,
                             const uint8_t *mask);
/* Scales K with the picture. */
void camera_resize(sherf_camera *camera, int width_px, int height_px);

/* ---- rays (network.md: Rays and points 1) ---- */
typedef struct {
    int width, height;
    float origin_world[3];
    float *direction;  /* N x 3, world, z_camera = 1 */
    float *near, *far; /* N; 0 and 1 where the ray misses; what lies behind the camera is cut off */
    uint8_t *at_box;   /* N */
} ray_bundle;
/* Depth of sample i of `samples`: near + (far - near) * fraction, evenly spaced, both ends included, in
 * float32 and from both ends inwards. */
HOST_AND_DEVICE static inline float ray_fraction(int i, int samples) {
    if (samples < 2) return 0;
    float step = 1.0f / (float)(samples - 1);
    return i < samples / 2 ? step * (float)i : 1.0f - step * (float)(samples - 1 - i);
}
sherf_status rays_create(context *c, const sherf_camera *camera, const float min_world[3],
                         const float max_world[3],
                         ray_bundle **out); /* min/max: the target vertices' -/+ 0.05, see body_world_box */
void rays_free(ray_bundle *r);
/* The paper's way of rays_create takes a ray that crosses exactly two faces, and now and then rounding loses
 * one or counts one twice: a black pixel. These get their two depths here. For frames that people look at;
 * not for scores. */
void rays_mend(ray_bundle *r, const float min_world[3], const float max_world[3]);
/* At most step_m metres between two depths of any ray: returns how many depths a ray has, `samples` at least
 * and `most` at most (steps are longer then). A ray that is short enough keeps its `samples` steps, the same
 * length with more of them; others get steps of step_m. Depths past the box, where nothing is, are why far is
 * moved. Where no ray is too long nothing changes. */
int rays_even_steps(ray_bundle *r, int samples, int most, float step_m);
void body_world_box(const body_model *m, const posed_body *p, float min_world[3], float max_world[3]);

/* ---- the samples the network meets (network.md: Rays and points 2, 3) ---- */
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
    float *observation_world; /* P x 3 before that projection; only when asked for */
    int32_t *nearest;         /* P, target vertex; only when asked for (keep_stages) */
} point_set;
/* Cells of canonical space in which there is known to be nothing: bit x % 32 of bit[(z * cells[1] + y) *
 * words + x / 32]. Without bits nothing is known. */
typedef struct {
    int cells[3], words;
    float min[3], per_m;
    uint32_t *bit;
} empty_cells;
/* observation and observation_camera may both be NULL. keep_stages: fill the stage arrays for tests. Exactly
 * the samples whose nearest target vertex is closer than 0.05 m, without those in cells of `empty` (or NULL);
 * in ray-major, then depth order; found without visiting the empty ones. */
sherf_status points_create(context *c, const body_model *m, const posed_body *target, const ray_bundle *rays,
                           int samples, const posed_body *observation, const sherf_camera *observation_camera,
                           const empty_cells *empty, bool keep_stages, point_set **out);
void points_free(point_set *p);
/* Makes what points_create needs of a posed body, once, for those who take many pictures of one pose; without
 * it each call makes its own. */
sherf_status points_prepare(context *c, const body_model *m, posed_body *target);

/* Room for the three pictures of a frame, kept where it has that size. */
sherf_status frame_shape(context *c, int width, int height, sherf_frame *frame);

/* A frame made whole on a GPU, from a pose. */
typedef struct {
    int samples;      /* depths a ray, */
    int samples_most; /* and up to so many where steps would be longer than step_most_m (rays_even_steps); 0:
                         not */
    float step_most_m;
    bool mend; /* rays_mend */
    float background[3];
    bool early_stop;          /* rays that are opaque skip the rest of their points */
    const empty_cells *empty; /* or NULL; all frames of an avatar that give one give the same */
} gpu_frame_options;

/* ---- visibility of the observation's vertices: n_camera . x_camera < 0 ---- */
sherf_status vertices_visible(context *c, const body_model *m, const float *vertices_world,
                              const sherf_camera *camera, int32_t *visible);

/* ---- rasteriser: z-buffered triangles with interpolated attributes, for synth, check and overlays ---- */
typedef struct {
    int width, height;
    float *depth;       /* H x W, metres, infinity where empty */
    int32_t *face;      /* H x W, -1 where empty */
    float *barycentric; /* H x W x 3 (perspective-correct) */
} raster;
/* `supersample` >= 1 renders width*supersample etc.; the caller averages. */
sherf_status raster_create(context *c, const sherf_camera *camera, int supersample, int64_t vertices,
                           const float *vertex_world, int64_t faces, const uint32_t *face, raster **out);
void raster_free(raster *r);

/* ---- the box's masks ---- */
/* The mask of the scores and losses: 1 where the pixel's ray crosses the box as in rays_create (its at_box).
 * The reference's PSNR and bounding rectangles are those of this mask. The camera must have passed
 * camera_check. */
void box_ray_mask(const sherf_camera *camera, const float min_world[3], const float max_world[3],
                  uint8_t *mask);

/* ---- the projected box, as OpenCV's fillPoly on the 8 projected corners' 6
 * faces ---- */
/* mask: H x W, 1 inside. Corners of the world box (min/max -/+ 0.05) are projected, rounded to nearest (half
 * to even) to integers, each of the box's 6 faces is filled as a polygon including its border. */
void box_mask(const sherf_camera *camera, const float min_world[3], const float max_world[3], uint8_t *mask);

#ifdef __cplusplus
}
#endif
#endif
