/* Sampling the bank at points in float32; for files that define LANES. */
#ifndef SHERF_RADIANCE_FLOAT_SAMPLE_H
#define SHERF_RADIANCE_FLOAT_SAMPLE_H

#include <string.h>

#include "base/simd.h"
#include "model/sherf/fused/inside.h"

/* ---- sampling: point by point, channels side by side ---- */
typedef struct {
    const float *row;
    float weight;
} tap;

/* floor and fraction of a position; -2 when it is outside [-1, size) (a NaN is). */
static inline int low_corner(float x, int size, float *fraction) {
    *fraction = 0;
    if (!(x >= -1.0f && x < (float)size)) return -2;
    float low = floorf(x);
    *fraction = x - low;
    return (int)low;
}

static int bilinear_taps(const float *texel, int width, int height, int stride, float x, float y,
                         tap taps[4]) {
    float fx, fy;
    int ix = low_corner(x, width, &fx), iy = low_corner(y, height, &fy), n = 0;
    if (ix < -1 || iy < -1) return 0;
    for (int k = 0; k < 4; k++) {
        int cx = ix + (k & 1), cy = iy + (k >> 1);
        if (cx < 0 || cy < 0 || cx >= width || cy >= height) continue;
        taps[n].row = texel + ((size_t)cy * (size_t)width + (size_t)cx) * (size_t)stride;
        taps[n++].weight = ((k & 1) ? fx : 1.0f - fx) * ((k >> 1) ? fy : 1.0f - fy);
    }
    return n;
}

static int trilinear_taps(const radiance_level *l, const float p[3], tap taps[8]) {
    float fx, fy, fz;
    int x = low_corner(p[0] * l->voxels_per_m[0], l->size[2], &fx),
        y = low_corner(p[1] * l->voxels_per_m[1], l->size[1], &fy),
        z = low_corner(p[2] * l->voxels_per_m[2], l->size[0], &fz), n = 0;
    if (x < -1 || y < -1 || z < -1) return 0;
    int64_t at = ((int64_t)(z + 1) * (l->size[1] + 1) + (y + 1)) * (l->size[2] + 1) + (x + 1);
    if (l->cell[at] < 0) return 0;
    const int32_t *corner = l->corner[l->cell[at]];
    for (int k = 0; k < 8; k++) {
        if (!corner[k]) continue;
        taps[n].row = l->value + (size_t)corner[k] * (size_t)l->stride;
        taps[n++].weight =
            ((k & 1) ? fx : 1.0f - fx) * ((k & 2) ? fy : 1.0f - fy) * ((k & 4) ? fz : 1.0f - fz);
    }
    return n;
}

/* out[0 .. width) += sum of weighted rows; width is rounded up to whole vectors (rows are padded with
 * zeros, out has room). */
static void add_taps(const tap *taps, int n, int width, float *out) {
    for (int c = 0; c < width; c += LANES) {
        vf sum = *(vf_any *)(out + c);
        for (int k = 0; k < n; k++) sum += *(const vf_any *)(taps[k].row + c) * taps[k].weight;
        *(vf_any *)(out + c) = sum;
    }
}

/* The components along a plane's width and height. */
static const int plane_axis[3][2] = {{0, 1}, {0, 2}, {2, 1}};

/* Everything read from the bank for point p: tokens [3 D] before the colour, and the colour. */
static void sample_point(const radiance_field *n, const point_tile *t, int p, float *token, float color[4]) {
    tap taps[8 * POINT_LEVELS];
    int width = n->s.token_width;
    memcpy(token, n->token_b, (size_t)n->fused * sizeof(float));
    float at[3], texel[3];
    for (int i = 0; i < 3; i++) {
        at[i] = t->position[i][p] - n->volume_min[i];
        texel[i] = (t->position[i][p] - n->plane_min[i]) * n->plane_scale[i] - 0.5f;
    }
    for (int i = 0; i < 3; i++) {
        const radiance_map *map = &n->plane[i];
        int k = bilinear_taps(map->texel, map->width, map->height, map->stride, texel[plane_axis[i][0]],
                              texel[plane_axis[i][1]], taps);
        add_taps(taps, k, width, token + i * width);
    }
    float u = t->pixel[0][p], v = t->pixel[1][p];
    const radiance_map *map = &n->map;
    int k = bilinear_taps(map->texel, map->width, map->height, map->stride, u * n->map_scale[0],
                          v * n->map_scale[1], taps);
    add_taps(taps, k, n->map_tokens * width, token);
    k = 0;
    for (int i = 0; i < POINT_LEVELS; i++) k += trilinear_taps(&n->level[i], at, taps + k);
    add_taps(taps, k, n->fused, token);
    k = bilinear_taps(n->image, n->image_width, n->image_height, 4, u * n->image_scale[0],
                      v * n->image_scale[1], taps);
    for (int i = 0; i < 3; i++) {
        color[i] = 0;
        for (int j = 0; j < k; j++) color[i] += taps[j].weight * taps[j].row[i];
    }
}

#endif
