/* A radiance field as plain arrays in the host's memory: the bank after the linear layers before fusion and
 * the layers after the algebra that does not depend on points (inside.h), for backends of its own
 * kind. */
#ifndef SHERF_RADIANCE_PARTS_H
#define SHERF_RADIANCE_PARTS_H

#include "model/sherf/fused/radiance_field.h"

#ifdef __cplusplus
extern "C" {
#endif

/* height x width texels of `stride` values, zeros behind the used ones. */
typedef struct {
    int width, height, stride;
    const float *texel;
} radiance_part_map;

/* A cell is the cube between 8 voxels; cell (x, y, z) has its low corner at voxel (x - 1, y - 1, z - 1). */
typedef struct {
    int size[3]; /* z y x, voxels */
    float voxels_per_m[3];
    const int32_t *cell;   /* [z + 1][y + 1][x + 1]: index of corner, or -1: nothing there */
    const int32_t *corner; /* [corners][8]: rows of value, x fastest; row 0 is zeros */
    int64_t corners, rows;
    int stride;
    const float *value;
} radiance_part_level;

typedef struct {
    int rows, columns;
    const float *w, *b; /* row-major; y = w x + b */
} radiance_part_matrix;

typedef struct {
    radiance_sizes s;
    int fused, position_width, direction_width, color_width, color_token, map_tokens, attention_width;
    float plane_min[3], plane_scale[3]; /* texel = (x - min) * scale - 0.5 */
    radiance_part_map plane[3], map;
    float map_scale[2], image_scale[2]; /* texel = pixel * scale */
    int image_width, image_height;
    const float *image; /* 4 values a pixel: red, green, blue, 0 */
    float volume_min[3];
    radiance_part_level level[POINT_LEVELS];
    const float *norm0_w, *norm0_b, *norm1_w, *norm1_b, *token_b;
#define MATRIX(name) radiance_part_matrix name;
    RADIANCE_LAYERS(MATRIX)
#undef MATRIX
    radiance_part_matrix pts[POINT_DECODER_MAX];
    float bank_top; /* the largest magnitude of maps and levels */
    void *owner;
} radiance_parts;

sherf_status radiance_parts_create(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                   const radiance_bank *bank, radiance_parts *out);
void radiance_parts_free(radiance_parts *p);

#ifdef __cplusplus
}
#endif
#endif
