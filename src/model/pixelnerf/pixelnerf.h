/* pixelnerf: PixelNeRF of one picture (Yu et al., CVPR 2021), a rival of SHERF: pixel-aligned features of a
 * ResNet's stages, a field in the input camera's axes that does not use the body (docs/rivals.md). */
#ifndef SHERF_MODEL_PIXELNERF_H
#define SHERF_MODEL_PIXELNERF_H

#include "model/model.h"
#include "nn/resnet.h"

enum { PIXELNERF_STAGES = 4, PIXELNERF_BLOCKS = 5, PIXELNERF_FED = 3, PIXELNERF_NETWORKS = 2 };

/* Settings; the paper's in brackets. */
typedef struct {
    int encoder;       /* layers of the ResNet; only the stem and three stages are used [34] */
    int encoder_width; /* channels of its stem [64] */
    int pool;          /* the max pooling behind the stem [1; 0 for pictures of 64 x 64] */
    int width;         /* of the field's network [512] */
    int passes;        /* 2: a second network runs at depths drawn by the first one's weights [2] */
    int drawn, around; /* depths drawn by the weights; depths around the mean depth [16 16] */
    int shell;         /* only points within 5 cm of the body, which PixelNeRF itself does not use [0] */
    int own;           /* 1: trained as its authors do, at their depths; 0: as SHERF is [1] */
} pixelnerf_settings;

/* h = in(point, direction); five residual blocks, with features added before each of the first three; out. */
typedef struct {
    linear_layer in, out, feature[PIXELNERF_FED];
    struct {
        linear_layer fc[2];
    } block[PIXELNERF_BLOCKS];
} pixelnerf_field;
typedef struct {
    resnet encoder;
    pixelnerf_field field[PIXELNERF_NETWORKS];
} pixelnerf_network;

/* model_bank.own; the bank has, for each network, three maps [H/2, W/2, width] of the features to add. */
typedef struct {
    int network;                     /* whose maps come first */
    tensor *stage[PIXELNERF_STAGES]; /* the encoder's stages, each with its own size */
} pixelnerf_bank;

#endif
