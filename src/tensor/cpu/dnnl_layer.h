/* layer: a convolution for inference whose weights and sizes never change. Bias, sum and activation are part
 * of one oneDNN primitive, and its weights are packed once. float32, pictures [H, W, C]. */
#ifndef SHERF_DNNL_LAYER_H
#define SHERF_DNNL_LAYER_H

#include "base/base.h"

typedef enum { LAYER_LINEAR, LAYER_RELU, LAYER_RELU6 } layer_activation;

/* y = then(sum + bias + weight * x); pairs are (down, across). The caller checks the sizes. */
typedef struct {
    int size[2], in, out;                          /* x is [size[0], size[1], in], y has `out` channels */
    bool depthwise;                                /* in == out, one kernel for each channel */
    int kernel[2], stride[2], before[2], after[2]; /* zeros before and after x */
    bool adds;                                     /* the sum is y's previous value; else 0 */
    layer_activation then;
} layer_shape;

typedef struct layer layer;
/* weight: [kernel, kernel, in, out], depthwise [kernel, kernel, in]; bias: [out] or NULL. Copies both. oneDNN
 * splits the work for the context's current threads; the layer always runs with that number. */
sherf_status layer_create(context *c, const layer_shape *shape, const float *weight, const float *bias,
                          layer **out);
void layer_free(layer *l);
size_t layer_scratch_bytes(const layer *l);
/* scratch: 64-byte aligned, layer_scratch_bytes long. May run in several threads at once. */
sherf_status layer_run(context *c, const layer *l, const float *x, float *y, void *scratch);
#endif
