/* One pixel's ray and one sample of it, for the CPU's loops (rays.c, points.c) and for GPU kernels. */
#ifndef SHERF_RAY_H
#define SHERF_RAY_H

#include <math.h>

#include "scene/scene.h"

#ifdef __cplusplus
extern "C" {
#endif

#define BOX_SPARE_M 0.01f /* rays_create's box is larger than the given one by this much */

/* Values that all rays of a picture share. */
typedef struct {
    float K_inverse[9], R[9], T_m[3], origin[3]; /* origin: of the rays, in the world */
} ray_optics;
void ray_optics_of(const sherf_camera *camera, ray_optics *out);
/* Metres between two neighbouring pixels at the depth of the box's nearest point (ray_extent); infinite if
 * the box is not in the picture. */
float rays_pitch(const ray_bundle *r, float nearest);

/* Depths of the two crossings of origin + t * direction with the box's faces; false unless exactly two. */
HOST_AND_DEVICE static inline bool cross_box(const float origin[3], const float direction[3],
                                             const float min[3], const float max[3], float *near,
                                             float *far) {
    const float spare = 1e-6f;
    float t[6];
    int crossings = 0;
    for (int face = 0; face < 6; face++) {
        int k = face % 3;
        if (direction[k] == 0) continue;
        float at = ((face < 3 ? min[k] : max[k]) - origin[k]) / direction[k];
        bool inside = true;
        for (int a = 0; a < 3; a++) {
            float x = at * direction[a] + origin[a];
            inside &= x >= min[a] - spare && x <= max[a] + spare;
        }
        if (inside) t[crossings++] = at;
    }
    if (crossings != 2) return false;
    float first = t[0] < t[1] ? t[0] : t[1], last = t[0] < t[1] ? t[1] : t[0];
    if (!(last > 0)) return false; /* the box is behind the camera */
    *near = first > 0 ? first : 0; /* nothing behind a camera inside the box */
    *far = last;
    return true;
}

/* As cross_box, but also if rounding put a crossing beside its face or on two faces, one pixel in some
 * hundred thousand: the interval common to the three pairs of faces has no such holes. Elsewhere the result
 * is the same to the bit. */
HOST_AND_DEVICE static inline bool cross_slabs(const float origin[3], const float direction[3],
                                               const float min[3], const float max[3], float *near,
                                               float *far) {
    float first = -INFINITY, last = INFINITY;
    for (int k = 0; k < 3; k++) {
        if (direction[k] == 0) {
            if (origin[k] < min[k] || origin[k] > max[k]) return false;
            continue;
        }
        const float a = (min[k] - origin[k]) / direction[k], b = (max[k] - origin[k]) / direction[k];
        const float low = a < b ? a : b, high = a < b ? b : a; /* fminf and fmaxf are calls */
        first = low > first ? low : first;
        last = high < last ? high : last;
    }
    if (!(last > first && last > 0 && last < INFINITY)) return false;
    *near = first > 0 ? first : 0;
    *far = last;
    return true;
}

/* The pixel's point at z_camera = 1, R^T (K^-1 (i, j, 1) - T), minus the origin: in float32 and this order.
 */
HOST_AND_DEVICE static inline void ray_direction(const ray_optics *o, int column, int row,
                                                 float direction[3]) {
    const float *K = o->K_inverse, *R = o->R, *T = o->T_m;
    float p[3];
    for (int k = 0; k < 3; k++)
        p[k] = K[3 * k] * (float)column + K[3 * k + 1] * (float)row + K[3 * k + 2] - T[k];
    for (int k = 0; k < 3; k++) direction[k] = R[k] * p[0] + R[3 + k] * p[1] + R[6 + k] * p[2] - o->origin[k];
}

/* The point at depth t of a ray, in the body's own space: (origin + t d - Th) R. */
HOST_AND_DEVICE static inline void ray_point_smpl(const float origin_world[3], const float *direction,
                                                  float t, const float *R, const float *Th, float out[3]) {
    float x[3];
    for (int k = 0; k < 3; k++) x[k] = origin_world[k] + t * direction[k] - Th[k];
    for (int k = 0; k < 3; k++) out[k] = x[0] * R[k] + x[1] * R[3 + k] + x[2] * R[6 + k];
}

/* uv = K (R x + T) / (z + 1e-5); returns z. */
HOST_AND_DEVICE static inline float project_point(const float *K, const float *R, const float *T,
                                                  const float *p, float *uv_px) {
    float x = R[0] * p[0] + R[1] * p[1] + R[2] * p[2] + T[0];
    float y = R[3] * p[0] + R[4] * p[1] + R[5] * p[2] + T[1];
    float z = R[6] * p[0] + R[7] * p[1] + R[8] * p[2] + T[2];
    float w = K[6] * x + K[7] * y + K[8] * z + 1e-5f;
    uv_px[0] = (K[0] * x + K[1] * y + K[2] * z) / w;
    uv_px[1] = (K[3] * x + K[4] * y + K[5] * z) / w;
    return z;
}

#ifdef __cplusplus
}
#endif
#endif
