/* The backward pass in bf16 on AMX: what its preparation (train_amx.c) and its tile (train_tile_amx.c) share.
 */
#ifndef SHERF_RADIANCE_TRAIN_AMX_H
#define SHERF_RADIANCE_TRAIN_AMX_H

#include "model/sherf/fused/amx_pack.h"
#include "model/sherf/fused/train_inside.h"

/* One backward pass. "Back" tiles are transposed weights. Sums are tiles [pair of row tiles][pair of column
 * tiles][2][2][16][16] over outputs and inputs as packed. */
typedef struct {
    radiance_trainer base; /* first member: the type that other files use */
    struct {
        RADIANCE_BACK_MEMBERS(tiles)
    } back;
    int view_blocks, qkv_blocks, color_tokens;
    int *slot; /* of the layer whose sums are given: SLOTS */
} amx_trainer;

/* train_tile_amx.c */
size_t radiance_train_scratch_bytes(const amx_trainer *r);
void radiance_train_tile_amx(const radiance_trainer *r, train_tile *t, float *lane, void *scratch);
enum { AMX_SCATTER_JOBS = 3 * POINT_LEVELS + 3 + 3 };
void radiance_scatter_amx(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                          int64_t count, const float *dtoken, const radiance_gradients *out);

#endif
