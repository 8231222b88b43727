/* Deformation: a point moves with its nearest vertex, whose affine maps were made with the pose (pose.c), or
 * with a blend of its maps and its neighbours'. */
#include <string.h>

#include "body/body.h"

static inline void rotate(const float *map, const float x[3], float out[3]) {
    for (int k = 0; k < 3; k++) out[k] = map[4 * k] * x[0] + map[4 * k + 1] * x[1] + map[4 * k + 2] * x[2];
}

/* Vertices with their maps, and how far they are blended. */
typedef struct {
    const body_model *m;
    const float *vertex, *maps;
    float blend_m;
} mapping;

static void blend(const mapping *g, size_t v, const float x[3], float map[12]) {
    const float *own = g->vertex + 3 * v, reach = 1 / (g->blend_m * g->blend_m);
    float d0 = 0, sum = 1;
    for (int k = 0; k < 3; k++) d0 += (x[k] - own[k]) * (x[k] - own[k]);
    memcpy(map, g->maps + 12 * v, 12 * sizeof *map);
    for (int32_t i = g->m->neighbour_first[v]; i < g->m->neighbour_first[v + 1]; i++) {
        const float *other = g->vertex + 3 * (size_t)g->m->neighbour[i];
        float d = 0;
        for (int k = 0; k < 3; k++) d += (x[k] - other[k]) * (x[k] - other[k]);
        float w = 1 - (d - d0) * reach;
        if (!(w > 0)) continue;
        if (w > 1) w = 1; /* `nearest` is not the nearest one */
        w *= w;
        sum += w;
        for (int k = 0; k < 12; k++) map[k] += w * g->maps[12 * (size_t)g->m->neighbour[i] + (size_t)k];
    }
    for (int k = 0; k < 12; k++) map[k] /= sum;
}

/* The map of point i at x; `room` is for a blended one. */
static inline const float *map_of(const mapping *g, const int32_t *nearest, int64_t i, const float x[3],
                                  float room[12]) {
    const int64_t v = nearest ? nearest[i] < 0 ? 0 : nearest[i] : i;
    if (!nearest || g->blend_m == 0) return g->maps + 12 * v;
    blend(g, (size_t)v, x, room);
    return room;
}

static void apply(const mapping *g, int64_t n, const float *points, const float *directions,
                  const int32_t *nearest, float *points_out, float *directions_out) {
    for (int64_t i = 0; i < n; i++) {
        float x[3], y[3], room[12];
        memcpy(x, points + 3 * i, sizeof x);
        const float *map = map_of(g, nearest, i, x, room);
        rotate(map, x, y);
        for (int k = 0; k < 3; k++) points_out[3 * i + k] = y[k] + map[4 * k + 3];
        if (!directions) continue;
        memcpy(x, directions + 3 * i, sizeof x);
        rotate(map, x, directions_out + 3 * i);
    }
}

void deform_to_canonical(const body_model *m, const posed_body *p, int64_t n, const float *points_smpl,
                         const float *directions_smpl, const int32_t *nearest, float *points_canonical,
                         float *directions_canonical) {
    const mapping g = {m, p->vertices_smpl, p->to_canonical, p->blend_m};
    apply(&g, n, points_smpl, directions_smpl, nearest, points_canonical, directions_canonical);
}

void deform_from_canonical(const body_model *m, const posed_body *p, int64_t n, const float *points_canonical,
                           const int32_t *nearest, float *points_world) {
    const mapping g = {m, m->canonical->vertices_smpl, p->from_canonical, p->blend_m};
    apply(&g, n, points_canonical, NULL, nearest, points_world, NULL);
}
