/* resnet: ResNet-18 and ResNet-34, the encoders of several models (He et al., CVPR 2016), with torchvision's
 * names. */
#ifndef SHERF_RESNET_H
#define SHERF_RESNET_H

#include "nn/layers.h"

enum { RESNET_STAGES = 4, RESNET_BLOCKS = 6 /* of a stage, at most */ };
typedef struct {
    int stride;
    tensor *conv[2], *shortcut; /* shortcut: NULL if the block keeps the size */
    batch_norm norm[2], shortcut_norm;
} resnet_block;
typedef struct {
    tensor *stem;
    batch_norm stem_norm;
    int stages, blocks[RESNET_STAGES];
    resnet_block block[RESNET_STAGES][RESNET_BLOCKS];
} resnet;

/* The stem and the first `stages` of the four stages of a network of `depth` layers, 18 or 34; stage n has
 * `width` << (n - 1) channels. */
void resnet_declare(declaration *d, const char *prefix, int depth, int64_t width, int stages, resnet *out);
tensor *resnet_stem(tape *t, const resnet *r, tensor *image); /* [H, W, 3] -> [H/2, W/2, width] */
/* Stages count from 1; from the second on a stage halves the sides. */
tensor *resnet_stage(tape *t, const resnet *r, int stage, tensor *x);

#endif
