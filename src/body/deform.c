/* Deformation: a point moves with its nearest vertex, whose affine maps were made with the pose (pose.c). */
#include <string.h>

#include "body/body.h"

static inline void rotate(const float *map, const float x[3], float out[3]) {
    for (int k = 0; k < 3; k++) out[k] = map[4 * k] * x[0] + map[4 * k + 1] * x[1] + map[4 * k + 2] * x[2];
}

static inline const float *map_of(const float *maps, const int32_t *nearest, int64_t i) {
    int64_t v = nearest ? nearest[i] : i;
    return maps + 12 * (v < 0 ? 0 : v);
}

static void apply(const float *maps, int64_t n, const float *points, const int32_t *nearest, float *out) {
    for (int64_t i = 0; i < n; i++) {
        const float *map = map_of(maps, nearest, i);
        float x[3], y[3];
        memcpy(x, points + 3 * i, sizeof x);
        rotate(map, x, y);
        for (int k = 0; k < 3; k++) out[3 * i + k] = y[k] + map[4 * k + 3];
    }
}

void deform_to_canonical(const body_model *m, const posed_body *p, int64_t n, const float *points_smpl,
                         const float *directions_smpl, const int32_t *nearest, float *points_canonical,
                         float *directions_canonical) {
    apply(p->to_canonical, n, points_smpl, nearest, points_canonical);
    for (int64_t i = 0; i < n && directions_smpl; i++) {
        float x[3], y[3];
        memcpy(x, directions_smpl + 3 * i, sizeof x);
        rotate(map_of(p->to_canonical, nearest, i), x, y);
        memcpy(directions_canonical + 3 * i, y, sizeof y);
    }
}

void deform_from_canonical(const body_model *m, const posed_body *p, int64_t n, const float *points_canonical,
                           const int32_t *nearest, float *points_world) {
    apply(p->from_canonical, n, points_canonical, nearest, points_world);
}
