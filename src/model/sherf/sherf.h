/* Layers shared by the parts of the network, looked up by their checkpoint names. */
#ifndef SHERF_LAYERS_H
#define SHERF_LAYERS_H

#include "model/model.h"

/* y = x W^T + b of the layer `name` (its .weight may have trailing dimensions of 1). */
tensor *layer_linear(tape *t, const model *m, tensor *x, const char *name);
/* The same with run-time factors. */
tensor *layer_linear_scaled(tape *t, const model *m, tensor *x, const char *name, float gain,
                            float bias_gain);
tensor *layer_batch_norm(tape *t, const model *m, tensor *x, const char *name, float eps, float momentum,
                         bool relu);

/* encoder.c: section 1. */
tensor *encoder_global(tape *t, const model *m, tensor *image);   /* [H, W, 3] -> [L] */
tensor *encoder_features(tape *t, const model *m, tensor *image); /* [H, W, 3] -> [H/2, W/2, F] */
/* 96 values of each position: feature map and colour encoding (the pixel-aligned feature). position_px [P,
 * 2]. */
tensor *pixel_sample(tape *t, const model *m, const model_bank *bank, const float *position_px,
                     int64_t count);

/* triplane.c: section 2. */
tensor *triplane_style(tape *t, const model *m, tensor *latent); /* [L] -> [style_width] */
tensor *triplane_synthesis(tape *t, const model *m, tensor *style, model_stages *stages); /* [R, R, 3 D] */
/* [P, D] of plane 0..2 at canonical points. */
void triplane_sample(tape *t, const body_model *body, const model_bank *bank, const float *points_canonical,
                     int64_t count, tensor *out[3]);

/* volume.c: section 3. */
sherf_status volume_encode(tape *t, const model *m, const observation_geometry *g, model_bank *bank);
/* [P, sum of channels] at canonical points. */
tensor *volume_sample(tape *t, const observation_geometry *g, const model_bank *bank,
                      const float *points_canonical, int64_t count);

/* fusion.c: section 4. [P, 3 D]: the three tokens side by side. */
tensor *fusion(tape *t, const model *m, tensor *const plane[3], tensor *pixel, tensor *volume);

/* decoder.c: section 5. */
void decoder(tape *t, const model *m, tensor *tokens, const float *points_canonical,
             const float *directions_canonical, int64_t count, tensor **sigma, tensor **rgb);

/* points_fused.c: all points at once through the fused network (model/sherf/fused/train.h), recorded; for
 * training in bf16. sigma [P, 1] and rgb [P, 3] are filled. */
bool points_fused_possible(tape *t, const model *m);
sherf_status points_fused(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, const point_set *points, tensor *sigma, tensor *rgb);

#endif
