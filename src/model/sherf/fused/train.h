/* train: the fused point network backwards, for training in bf16 on AMX. Forwards the network is a
 * point_network over a bank that has already been through the linear layers before fusion (point_merged), so
 * that a tape can take their gradients; backwards every tile of points is computed again in cache and its
 * gradients follow. It equals the op-by-op path (model/) within bf16 rounding. */
#ifndef SHERF_POINTNET_TRAIN_H
#define SHERF_POINTNET_TRAIN_H

#include "model/sherf/fused/radiance_field.h"
#include "tensor/tensor.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Where gradients go; float32, added to. */
typedef struct {
    /* A weight at address p of point_weights has its gradient at grads + (p - values). */
    const float *values;
    float *grads;
    /* of the point_merged that the network was made from, same shapes */
    float *plane[3], *map, *level[POINT_LEVELS];
} point_gradients;

/* Whether these sizes and this processor have the fused way. */
bool point_training_possible(const point_sizes *s);

/* d(loss) of every point's rgb [P, 3] and raw density [P] -> gradients. n: made with bf16 from weights and a
 * merged bank; rgb: its result for the points. Points without gradient are skipped. The same bits with any
 * number of threads. `work` gives the memory: reset it before, and after. */
sherf_status point_network_backward(tape *work, const point_network *n, const point_weights *weights,
                                    const point_set *points, const float *rgb, const float *drgb,
                                    const float *dsigma, const point_gradients *out);

#ifdef __cplusplus
}
#endif
#endif
