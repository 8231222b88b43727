/* resnet50: a perceptual distance on ImageNet's ResNet-50 (He et al. 2015): its stem and stages 2 and 3, with
 * the batch norms folded into the convolutions. It works like LPIPS, but has neither its network nor its
 * learned heads, hence its own name. The weights are never trained. */
#ifndef SHERF_RESNET50_H
#define SHERF_RESNET50_H

#include "tensor/tensor.h"

enum { RESNET50_CONVOLUTIONS = 24, RESNET50_FEATURES = 3, RESNET50_SIDE_MIN = 16 };

typedef struct {
    tensor *weight[RESNET50_CONVOLUTIONS]; /* [O, I, k, k] */
    tensor *bias[RESNET50_CONVOLUTIONS];   /* [O] */
} resnet50_network;

/* Keras' names, "res3b_branch2a"; block by block 2a, 2b, 2c and, in a stage's first block, the shortcut's 1.
 */
typedef struct {
    const char *name;
    int in, out, side, stride;
} resnet50_layer;
extern const resnet50_layer resnet50_layers[RESNET50_CONVOLUTIONS];

/* All weights 0, for the caller to fill (eval/resnet50_file.h reads files). */
sherf_status resnet50_create(context *c, resnet50_network **out);
void resnet50_free(resnet50_network *n);
/* Moves the weights to another memory, once (tensor_place); n or memory may be NULL. */
sherf_status resnet50_place(context *c, resnet50_network *n, const tensor_memory *memory);

/* A scalar, for pictures [H, W, 3] in [0, 1], both sides >= RESNET50_SIDE_MIN. Compares the stem before its
 * pooling [H/2, W/2, 64], stage 2 [H/4, W/4, 256] and stage 3 [H/8, W/8, 512], sizes rounded up, all after
 * ReLU: for each the mean over pixels of |a / |a| - b / |b||^2 over channels. Their sum is 0 to 6. Gradient
 * to a only. */
tensor *resnet50_distance(tape *t, const resnet50_network *n, tensor *a, tensor *b);

#endif
