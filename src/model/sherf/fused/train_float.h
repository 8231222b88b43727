/* The backward pass in float32: what its preparation (train_float.c) and its tile (train_tile_float.h,
 * compiled for every instruction set) share. */
#ifndef SHERF_RADIANCE_TRAIN_FLOAT_H
#define SHERF_RADIANCE_TRAIN_FLOAT_H

#include "model/sherf/fused/train_inside.h"

/* What an instruction set's kernels keep in registers: `rows` outputs of `strip` points, or of as many
 * inputs. */
typedef struct {
    int rows, strip, lanes;
    size_t (*scratch_bytes)(const radiance_trainer *r);
    void (*tile)(const radiance_trainer *r, train_tile *t, float *lane, void *scratch);
    void (*scatter)(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                    int64_t count, const float *dtoken, const radiance_gradients *out);
} train_float_kernels;
extern const train_float_kernels train_float_plain, train_float_neon, train_float_avx2, train_float_avx512;

/* Layers forwards, and backwards their transposed weights; all in blocks of `rows` outputs. Sums are [panel
 * of `strip` inputs][outputs, in whole blocks of `rows`][strip]. */
typedef struct {
    radiance_trainer base; /* first member: the type that other files use */
    const train_float_kernels *kernels;
    RADIANCE_MEMBERS(radiance_layer)
    struct {
        RADIANCE_BACK_MEMBERS(radiance_layer)
    } back;
} float_trainer;

enum { FLOAT_SCATTER_JOBS = POINT_LEVELS + 1 + 3 };

#endif
