/* A point network as plain arrays in the host's memory: the bank after the linear layers before fusion and
 * the layers after the algebra that does not depend on points (inside.h), for backends of its own
 * kind. */
#ifndef SHERF_POINTNET_PARTS_H
#define SHERF_POINTNET_PARTS_H

#include "model/sherf/fused/radiance_field.h"

#ifdef __cplusplus
extern "C" {
#endif

/* height x width texels of `stride` values, zeros behind the used ones. */
typedef struct {
    int width, height, stride;
    const float *texel;
} point_part_map;

/* A cell is the cube between 8 voxels; cell (x, y, z) has its low corner at voxel (x - 1, y - 1, z - 1). */
typedef struct {
    int size[3]; /* z y x, voxels */
    float voxels_per_m[3];
    const int32_t *cell;   /* [z + 1][y + 1][x + 1]: index of corner, or -1: nothing there */
    const int32_t *corner; /* [corners][8]: rows of value, x fastest; row 0 is zeros */
    int64_t corners, rows;
    int stride;
    const float *value;
} point_part_level;

typedef struct {
    int rows, columns;
    const float *w, *b; /* row-major; y = w x + b */
} point_part_matrix;

typedef struct {
    point_sizes s;
    int fused, position_width, direction_width, color_width, color_token, map_tokens, attention_width;
    float plane_min[3], plane_scale[3]; /* texel = (x - min) * scale - 0.5 */
    point_part_map plane[3], map;
    float map_scale[2], image_scale[2]; /* texel = pixel * scale */
    int image_width, image_height;
    const float *image; /* 4 values a pixel: red, green, blue, 0 */
    float volume_min[3];
    point_part_level level[POINT_LEVELS];
    const float *norm0_w, *norm0_b, *norm1_w, *norm1_b, *token_b;
    point_part_matrix color, qkv, attention_out, mlp0, mlp1, pts[POINT_DECODER_MAX], alpha, views, rgb;
    float bank_top; /* the largest magnitude of maps and levels */
    void *owner;
} point_parts;

sherf_status point_parts_create(context *c, const point_sizes *sizes, const point_weights *weights,
                                const point_bank *bank, point_parts *out);
void point_parts_free(point_parts *p);

#ifdef __cplusplus
}
#endif
#endif
