/* Weights packed as AMX tiles: made by amx_pack.c, read by the bf16 kernels. */
#ifndef SHERF_RADIANCE_AMX_PACK_H
#define SHERF_RADIANCE_AMX_PACK_H

#include "model/sherf/fused/inside.h"

enum {
    WIDTH = 32, /* of a token: the only one supported here */
    GROUP = 16, /* points in a vector */
    PAIR = 64,  /* bytes of a pair of channels */
    TILE = 1024 /* bytes of a tile */
};
/* Weights as tiles: [pair of row tiles][column block][2][16 rows][32 columns]; if the number of row tiles is
 * odd, the last one is alone. bias: a value for each row, which the reader of the sums adds. */
typedef struct {
    int row_tiles, blocks;
    uint16_t *w;
    float *bias;
} tiles;

struct radiance_amx {
    RADIANCE_MEMBERS(tiles)
    int x_blocks, h_blocks,
        v_blocks;     /* of 32 channels: [PE(position), token 0], h, [PE(direction), token 1] */
    int mixed_blocks; /* attention's result and two ones for the bias */
    float *mlp1_b;
    /* where the parts of the scratch are, bytes */
    size_t x_pitch, v_pitch, h_pitch; /* of the activation buffers */
    size_t token, x, v, a, b, c, sample, row, color_tiles, normed, mixed, sums;
};
/* The values read at the points of one group. */
enum { TAPS = 4 * 4 + 4 }; /* 3 planes, the map, the image */
typedef struct {
    _Alignas(64) int32_t offset[TAPS][GROUP]; /* bytes */
    int32_t weight[TAPS][GROUP];              /* float16 twice; the image's are float */
    int32_t cell[POINT_LEVELS][GROUP];
    int32_t cell_weight[POINT_LEVELS][8][GROUP];
    float value[GROUP][3 * WIDTH];
    float color[GROUP][4];
} samples;

/* The matrix column of each input of a packed layer; -1: none. */
enum { SLOTS = 8192 };
void slots_plain(int *slot, int count); /* input i reads column i */
/* The decoder's layer i, and views: the three low parts of an encoding's first values follow it and use the
 * same columns. */
void slots_pts(const radiance_field *n, int i, int *slot);
void slots_views(const radiance_field *n, int *slot);

sherf_status tiles_pack(context *c, const radiance_matrix *m, int row_tiles, int blocks, const int *slot,
                        tiles *out);
void tiles_free(tiles *l);

/* q's weights are packed times this: attention's scale and log2 e. */
float radiance_q_scale(const radiance_field *n);

/* tile_amx.c: runs one tile. */
void radiance_tile_amx(const radiance_field *n, point_tile *t, void *scratch);

#endif
