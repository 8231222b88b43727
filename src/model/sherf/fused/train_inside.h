/* The inside of training: what the preparation and the AMX tile share. */
#ifndef SHERF_RADIANCE_TRAIN_INSIDE_H
#define SHERF_RADIANCE_TRAIN_INSIDE_H

#include "model/sherf/fused/amx_pack.h"
#include "model/sherf/fused/train.h"

/* Points of a tile of the backward pass: as many as keep activations and weights' gradients in the second
 * cache. */
enum { TRAIN_POINTS = 128, TRAIN_PARTS = TRAIN_POINTS / POINT_TILE };

/* A matrix gradient in a lane's memory, in floats: tiles [pair of row tiles][pair of column
 * tiles][2][2][16][16] over outputs and inputs as packed (row_tiles and column_tiles even), and rows of
 * partial sums [outputs][16]. */
typedef struct {
    int row_tiles, column_tiles;
    size_t w, b;
} matrix_place;

/* One backward pass. "Back" tiles are transposed weights. */
typedef struct {
    const radiance_field *n;
    tiles back_rgb, back_views, back_token1, back_pts[POINT_DECODER_MAX], back_skip_token0, back_token0,
        back_mlp1, back_mlp0, back_out, back_qkv;
    int view_blocks, qkv_blocks, color_tokens;
    matrix_place color, qkv, attention_out, mlp0, mlp1, pts[POINT_DECODER_MAX], views /* and alpha */, rgb;
    size_t norm0_w, norm0_b, norm1_w, norm1_b, token_b; /* rows of partial sums */
    size_t lane_floats, scratch_bytes;
} radiance_trainer;

typedef struct {
    point_tile part[TRAIN_PARTS];
    _Alignas(64) float dout[4][TRAIN_POINTS]; /* of the colour before the sigmoid, and of the density; 0
                                                 behind count */
    int count;
    float *dtoken; /* [count][3 D]: the gradient of what was sampled, out */
} train_tile;

/* train_tile_amx.c */
size_t radiance_train_scratch_bytes(const radiance_trainer *r);
void radiance_train_tile_amx(const radiance_trainer *r, train_tile *t, float *lane, void *scratch);
/* One part of the bank: job < POINT_SCATTER_JOBS; adds dtoken [count][3 D] of the points index[] to its
 * gradient. */
enum { POINT_SCATTER_JOBS = 3 * POINT_LEVELS + 3 + 3 };
void radiance_scatter_amx(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                          int64_t count, const float *dtoken, const radiance_gradients *out);

#endif
