/* train: the backward pass of the fused radiance field, for training. Forward, the network is a
 * radiance_field over a bank that has already passed the linear layers before fusion (radiance_merged), so
 * that a tape can take their gradients. Backward, every tile of points is recomputed in cache and its
 * gradients follow: in bf16 on AMX, in float32 on any processor. It equals the op-by-op path (model/) within
 * rounding. */
#ifndef SHERF_RADIANCE_TRAIN_H
#define SHERF_RADIANCE_TRAIN_H

#include "model/sherf/fused/radiance_field.h"
#include "tensor/tensor.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Destinations of the gradients; float32, added to. */
typedef struct {
    /* A weight at address p of radiance_weights has its gradient at grads + (p - values). */
    const float *values;
    float *grads;
    /* of the radiance_merged that the network was made from, same shapes */
    float *plane[3], *map, *level[POINT_LEVELS];
} radiance_gradients;

/* Whether the fused kernel supports these sizes and, in bf16, this processor. */
bool radiance_training_possible(const radiance_sizes *s, bool bf16);

/* d(loss) of every point's rgb [P, 3] and raw density [P] -> gradients. n: made from weights and a merged
 * bank; rgb: its result for the points. Skips points without gradient. The same bits for any number of
 * threads. `work` provides the memory: reset it before and after. */
sherf_status radiance_field_backward(tape *work, const radiance_field *n, const radiance_weights *weights,
                                     const point_set *points, const float *rgb, const float *drgb,
                                     const float *dsigma, const radiance_gradients *out);

#ifdef __cplusplus
}
#endif
#endif
