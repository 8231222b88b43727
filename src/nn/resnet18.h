/* resnet18: the encoder of several models (He et al., CVPR 2016), with the names of torchvision. */
#ifndef SHERF_RESNET18_H
#define SHERF_RESNET18_H

#include "nn/layers.h"

typedef struct {
    int stride;
    tensor *conv[2], *shortcut; /* shortcut: NULL where the block keeps the size */
    batch_norm norm[2], shortcut_norm;
} resnet18_block;
typedef struct {
    tensor *stem;
    batch_norm stem_norm;
    int stages;
    resnet18_block block[4][2];
} resnet18;

/* Stem and the first `stages` of the four stages; stage n has `width` << (n - 1) channels. */
void resnet18_declare(declaration *d, const char *prefix, int64_t width, int stages, resnet18 *out);
tensor *resnet18_stem(tape *t, const resnet18 *r, tensor *image); /* [H, W, 3] -> [H/2, W/2, width] */
/* Stages count from 1; from the second on a stage halves the sides. */
tensor *resnet18_stage(tape *t, const resnet18 *r, int stage, tensor *x);

#endif
