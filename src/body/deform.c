/* Deformation: a point moves by its nearest vertex's affine map, made with the pose (pose.c), or by a blend
 * of that map with the vertex's neighbours' maps. */
#include <string.h>

#include "body/deform_point.h"

/* The map of point i at x; `room` stores a blended one. */
static inline const float *map_of(const vertex_mapping *g, const int32_t *nearest, int64_t i,
                                  const float x[3], float room[12]) {
    const int64_t v = nearest ? nearest[i] < 0 ? 0 : nearest[i] : i;
    if (!nearest || g->blend_m == 0) return g->maps + 12 * v;
    map_blend(g, (size_t)v, x, room);
    return room;
}

static void apply(const vertex_mapping *g, int64_t n, const float *points, const float *directions,
                  const int32_t *nearest, float *points_out, float *directions_out) {
    for (int64_t i = 0; i < n; i++) {
        float x[3], y[3], room[12];
        memcpy(x, points + 3 * i, sizeof x);
        const float *map = map_of(g, nearest, i, x, room);
        map_rotate(map, x, y);
        for (int k = 0; k < 3; k++) points_out[3 * i + k] = y[k] + map[4 * k + 3];
        if (!directions) continue;
        memcpy(x, directions + 3 * i, sizeof x);
        map_rotate(map, x, directions_out + 3 * i);
    }
}

void deform_to_canonical(const body_model *body, const posed_body *p, int64_t n, const float *points_smpl,
                         const float *directions_smpl, const int32_t *nearest, float *points_canonical,
                         float *directions_canonical) {
    const vertex_mapping g = {p->vertices_smpl,      p->to_canonical, p->blend_m,
                              body->neighbour_first, body->neighbour, false};
    apply(&g, n, points_smpl, directions_smpl, nearest, points_canonical, directions_canonical);
}

static void from_canonical(const body_model *body, const float *maps, bool apart, float blend_m, int64_t n,
                           const float *points_canonical, const int32_t *nearest, float *points_world) {
    const vertex_mapping g = {
        body->canonical->vertices_smpl, maps, blend_m, body->neighbour_first, body->neighbour, apart};
    apply(&g, n, points_canonical, NULL, nearest, points_world, NULL);
}

void deform_from_canonical(const body_model *body, const posed_body *p, int64_t n,
                           const float *points_canonical, const int32_t *nearest, float *points_world) {
    from_canonical(body, p->from_canonical, false, p->blend_m, n, points_canonical, nearest, points_world);
}

void deform_to_picture(const body_model *body, const posed_body *p, int64_t n, const float *points_canonical,
                       const int32_t *nearest, float *points_world) {
    from_canonical(body, p->read_from ? p->read_from : p->from_canonical, p->read_from != NULL, p->blend_m, n,
                   points_canonical, nearest, points_world);
}
