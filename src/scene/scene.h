/* scene: cameras, rays, the body's box, a rasteriser. */
#ifndef SHERF_SCENE_H
#define SHERF_SCENE_H

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
/* SHERF_MISMATCH if no vertex of the posed body falls into the camera's picture, if all of it is smaller than
 * two pixels, or, with a mask (1 byte for each pixel), if no vertex falls where it is not 0. */
sherf_status body_in_picture(context *c, const body_model *body, const posed_body *p,
                             const sherf_camera *camera, const uint8_t *mask);
/* Joint positions in the camera's frame, metres. */
sherf_status body_joints_camera(context *c, const body_model *body, const sherf_pose *pose,
                                const sherf_camera *camera, float out[BODY_JOINTS][3]);
/* The scale of a person in this pose in the picture, in pixels per metre at the joints' mean distance; 0 if
 * that is behind the camera. The configuration's px_per_m is compared with it (sherf_observation_crop). */
sherf_status body_px_per_m(context *c, const body_model *body, const sherf_pose *pose,
                           const sherf_camera *camera, double *out);
/* Scales K with the picture. */
void camera_resize(sherf_camera *camera, int width_px, int height_px);

/* ---- rays (network.md: Rays and points 1) ---- */
typedef struct {
    int width, height;
    sherf_camera camera;
    float origin_world[3];
    float *direction;  /* N x 3, world, z_camera = 1 */
    float *near, *far; /* N; 0 and 1 if the ray misses; the part behind the camera is cut off */
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
                         const float max_world[3], ray_bundle **out); /* min/max: see body_world_box */
void rays_free(ray_bundle *r);
/* rays_create takes rays that cross exactly two faces, as the paper's code does. Sometimes rounding loses a
 * crossing or counts one twice, which leaves a black pixel. This function gives such rays their two depths:
 * for frames to look at, not for scores. */
void rays_repair(const context *c, ray_bundle *r, const float min_world[3], const float max_world[3]);
typedef struct {
    float nearest;   /* the smallest depth at which a ray meets the box; infinite if none does */
    float farthest;  /* the largest depth of all rays */
    float longest_m; /* the longest way through the box */
} ray_extent;
ray_extent rays_extent(const context *c, const ray_bundle *r);
/* Makes the steps between a ray's depths at most step_m metres, unless that takes more than `max` depths.
 * Returns the new number of depths of every ray, at least `samples`. A short ray keeps the length of its
 * steps, a long one gets steps of step_m. `far` moves: a ray's added depths may be past the box, where it is
 * empty. Nothing changes if no ray is too long. longest_m: of rays_extent. */
int rays_even_steps(const context *c, ray_bundle *r, float longest_m, int samples, int max, float step_m);
/* min/max of the posed vertices -/+ BODY_SHELL_M. */
void body_world_box(const body_model *body, const posed_body *p, float min_world[3], float max_world[3]);

/* ---- visibility of the observation's vertices: n_camera . x_camera < 0 ---- */
sherf_status vertices_visible(context *c, const body_model *body, const float *vertices_world,
                              const sherf_camera *camera, int32_t *visible);

/* ---- what the picture does not show (docs/network.md) ---- */
enum {
    SHOWN_SEEN,    /* the vertex faces the camera, and nothing is in front of it */
    SHOWN_BEHIND,  /* it is on the body's other side */
    SHOWN_COVERED, /* another limb is in front of it */
    SHOWN_OUTSIDE  /* of the picture or of the person in it */
};
/* One of these for every vertex. image: H x W x 3, black outside the person; NULL: all of it is the person.
 * beside_m: a limb covers this much more than itself in the picture. */
sherf_status body_shown(context *c, const body_model *body, const float *vertices_world,
                        const sherf_camera *camera, const float *image, float beside_m, uint8_t *shown);
/* A picture of the person in its own pose. image: H x W x 3, black outside the person; NULL: the person fills
 * it. sheet: 12, from this picture's world to the one in which points are read; NULL: the same world. */
typedef struct {
    const posed_body *body;
    const sherf_camera *camera;
    const float *image, *sheet;
} body_picture;
/* Fills p->read_from and p->seen of an observed body: each vertex is read in the picture that shows it best.
 * mirror: vertices that no picture shows are read at their mirror image, if that is shown. `p` may be the
 * body of a picture. */
sherf_status body_read_pictures(context *c, const body_model *body, int count, const body_picture *picture,
                                bool mirror, posed_body *p);

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

/* ---- the box's mask ---- */
/* The mask for scores and losses: H x W, 1 where the pixel's ray crosses the box as in rays_create (its
 * at_box). The reference's PSNR and bounding rectangles use this mask. The camera must have passed
 * camera_check. */
void box_ray_mask(const sherf_camera *camera, const float min_world[3], const float max_world[3],
                  uint8_t *mask);

#ifdef __cplusplus
}
#endif
#endif
