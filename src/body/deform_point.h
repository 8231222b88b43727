/* How one point moves with the body, for the CPU's loops (deform.c) and for GPU kernels. */
#ifndef SHERF_DEFORM_POINT_H
#define SHERF_DEFORM_POINT_H

#include <math.h>
#include <string.h>

#include "body/body.h"

/* Rotation only. */
HOST_AND_DEVICE static inline void map_rotate(const float *map, const float x[3], float out[3]) {
    for (int k = 0; k < 3; k++) out[k] = map[4 * k] * x[0] + map[4 * k + 1] * x[1] + map[4 * k + 2] * x[2];
}

/* Vertices with their maps, the blending radius, and their neighbours (body.h). */
typedef struct {
    const float *vertex, *maps;
    float blend_m;
    const int32_t *neighbour_first, *neighbour;
    bool apart; /* some maps lead to other places than their neighbours' (maps_part); these are not blended */
    const uint8_t *together; /* by neighbour: whether maps_join; NULL: unknown */
} vertex_mapping;

HOST_AND_DEVICE static inline bool map_mirrors(const float *m) {
    return m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
               m[2] * (m[4] * m[9] - m[5] * m[8]) <
           0;
}

HOST_AND_DEVICE static inline void map_point(const float *map, const float x[3], float out[3]) {
    map_rotate(map, x, out);
    for (int k = 0; k < 3; k++) out[k] += map[4 * k + 3];
}

/* Whether two neighbours' maps lead to different places, since one mirrors or leads into another picture. */
HOST_AND_DEVICE static inline bool maps_part(const float *a, const float *b, const float x[3]) {
    const float far_m = 0.2f; /* farther apart than limbs in one picture, closer than two pictures */
    float to[3], other[3], d = 0;
    if (map_mirrors(a) != map_mirrors(b)) return true;
    map_point(a, x, to);
    map_point(b, x, other);
    for (int k = 0; k < 3; k++) d += (to[k] - other[k]) * (to[k] - other[k]);
    return d > far_m * far_m;
}

/* From the vertex, which lies at x: the distance within which the next function's answer holds. */
#define MAPS_JOIN_M 0.2f
/* Whether two neighbours' maps surely lead to one place (not maps_part) from wherever is near x. */
HOST_AND_DEVICE static inline bool maps_join(const float *a, const float *b, const float x[3]) {
    const float near_m = 0.19f; /* less than maps_part's, for rounding */
    float to[3], other[3], d = 0, turn = 0;
    if (map_mirrors(a) != map_mirrors(b)) return false;
    map_point(a, x, to);
    map_point(b, x, other);
    for (int k = 0; k < 3; k++) d += (to[k] - other[k]) * (to[k] - other[k]);
    for (int k = 0; k < 12; k++) turn += k % 4 < 3 ? (a[k] - b[k]) * (a[k] - b[k]) : 0;
    return sqrtf(d) + MAPS_JOIN_M * sqrtf(turn) < near_m;
}

/* Whether the map of v's neighbour number i is left out at x, which is d0 from v, squared. */
HOST_AND_DEVICE static inline bool map_is_apart(const vertex_mapping *g, size_t v, int32_t i,
                                                const float x[3], float d0) {
    if (!g->apart || (g->together && g->together[i] && d0 < MAPS_JOIN_M * MAPS_JOIN_M)) return false;
    return maps_part(g->maps + 12 * v, g->maps + 12 * (size_t)g->neighbour[i], x);
}

/* map += w * by */
HOST_AND_DEVICE static inline void map_add(float map[12], float w, const float *by) {
#ifdef __CUDACC__
    for (int k = 0; k < 12; k++) map[k] += w * by[k];
#else
    typedef float four __attribute__((vector_size(16), aligned(4), may_alias));
    for (int k = 0; k < 12; k += 4) *(four *)(map + k) += w * *(const four *)(by + k);
#endif
}

/* The map at x of a point whose nearest vertex is v. */
HOST_AND_DEVICE static inline void map_blend(const vertex_mapping *g, size_t v, const float x[3],
                                             float map[12]) {
    const float *own = g->vertex + 3 * v, reach = 1 / (g->blend_m * g->blend_m);
    float d0 = 0, sum = 1;
    for (int k = 0; k < 3; k++) d0 += (x[k] - own[k]) * (x[k] - own[k]);
    memcpy(map, g->maps + 12 * v, 12 * sizeof *map);
    for (int32_t i = g->neighbour_first[v]; i < g->neighbour_first[v + 1]; i++) {
        const float *other = g->vertex + 3 * (size_t)g->neighbour[i];
        float d = 0;
        for (int k = 0; k < 3; k++) d += (x[k] - other[k]) * (x[k] - other[k]);
        float w = 1 - (d - d0) * reach;
        if (!(w > 0)) continue;
        const float *by = g->maps + 12 * (size_t)g->neighbour[i];
        if (map_is_apart(g, v, i, x, d0)) continue;
        if (w > 1) w = 1; /* `nearest` is not actually the nearest */
        w *= w;
        sum += w;
        map_add(map, w, by);
    }
    for (int k = 0; k < 12; k++) map[k] /= sum;
}

#endif
