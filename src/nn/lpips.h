/* lpips: the learned perceptual distance on VGG16 (Zhang et al. 2018), as a loss and as a score. Pictures are
 * in [0, 1], as for the paper's tables. The weights are never trained. */
#ifndef SHERF_LPIPS_H
#define SHERF_LPIPS_H

#include "tensor/tensor.h"

enum { LPIPS_CONVOLUTIONS = 13, LPIPS_STAGES = 5, LPIPS_SIDE_MIN = 16 };

typedef struct {
    tensor *weight[LPIPS_CONVOLUTIONS]; /* [O, I, 3, 3] */
    tensor *bias[LPIPS_CONVOLUTIONS];   /* [O] */
    tensor *head[LPIPS_STAGES];         /* [channels of the stage], non-negative */
} lpips_network;

/* VGG16's convolutions: index in the usual list of its layers, channels in and out, stage. */
typedef struct {
    int index, in, out, stage;
} lpips_layer;
extern const lpips_layer lpips_layers[LPIPS_CONVOLUTIONS];

/* All weights 0, for the caller to fill (eval/lpips_file.h reads files). */
sherf_status lpips_create(context *c, lpips_network **out);
void lpips_free(lpips_network *n);
/* Moves the weights to another memory, once (tensor_place); n or memory may be NULL. */
sherf_status lpips_place(context *c, lpips_network *n, const tensor_memory *memory);

/* Scalar: the distance of a and b [H, W, 3], both sides >= LPIPS_SIDE_MIN. Gradient to a only. */
tensor *lpips_distance(tape *t, const lpips_network *n, tensor *a, tensor *b);

#endif
