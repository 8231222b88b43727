/* A ball of triangles, closed or open. */
#ifndef TEST_BALL_H
#define TEST_BALL_H

#include <math.h>

#include "scene/solid.h"

enum { RINGS = 24, SECTORS = 48, VERTICES = (RINGS + 1) * SECTORS, TRIANGLES = 2 * RINGS * SECTORS };
typedef struct {
    float vertex[3 * VERTICES];
    uint32_t triangle[3 * TRIANGLES];
    solid_mesh mesh;
} ball;

/* A ball with the latitudes `first` to `last` of RINGS; it is open if these are not all. */
static inline void ball_make(ball *b, const float middle[3], float radius, int first, int last) {
    int64_t n = 0;
    for (int i = 0; i <= RINGS; i++)
        for (int k = 0; k < SECTORS; k++) {
            const double a = M_PI * i / RINGS, o = 2 * M_PI * k / SECTORS;
            const double at[3] = {sin(a) * cos(o), cos(a), sin(a) * sin(o)};
            for (int d = 0; d < 3; d++)
                b->vertex[3 * (i * SECTORS + k) + d] = middle[d] + radius * (float)at[d];
        }
    for (int i = first; i < last; i++)
        for (int k = 0; k < SECTORS; k++) {
            const uint32_t a = (uint32_t)(i * SECTORS + k), o = (uint32_t)(i * SECTORS + (k + 1) % SECTORS);
            const uint32_t corner[6] = {a, o, a + SECTORS, o, o + SECTORS, a + SECTORS};
            for (int j = 0; j < 6; j++) b->triangle[n++] = corner[j];
        }
    b->mesh = (solid_mesh){VERTICES, n / 3, b->vertex, b->triangle};
}

#endif
