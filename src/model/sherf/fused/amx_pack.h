/* Weights packed as tiles for AMX: what amx_pack.c makes and the bf16 kernels read. */
#ifndef SHERF_RADIANCE_AMX_PACK_H
#define SHERF_RADIANCE_AMX_PACK_H

#include "model/sherf/fused/inside.h"

enum {
    WIDTH = 32, /* of a token: the only one supported here */
    GROUP = 16, /* points of a vector */
    PAIR = 64,  /* bytes of a pair of channels */
    TILE = 1024 /* bytes of a tile */
};
/* Weights as tiles: [pair of row tiles][column block][2][16 rows][32 columns]; with an odd number of row
 * tiles the last comes alone. bias: a value a row, to be added by who reads the sums. */
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
/* What is read at the points of one group. */
enum { TAPS = 4 * 4 + 4 }; /* 3 planes, the map, the image */
typedef struct {
    _Alignas(64) int32_t offset[TAPS][GROUP]; /* bytes */
    int32_t weight[TAPS][GROUP];              /* float16 twice; the image's are float */
    int32_t cell[POINT_LEVELS][GROUP];
    int32_t cell_weight[POINT_LEVELS][8][GROUP];
    float value[GROUP][3 * WIDTH];
    float color[GROUP][4];
} samples;

/* The column of a matrix that each input of a packed layer has; -1: none. */
enum { SLOTS = 8192 };
void slots_plain(int *slot, int count); /* input i reads column i */
/* The decoder's layer i, and views: where an encoding is read, the three low parts of its first values stand
 * behind it and read the same columns. */
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
