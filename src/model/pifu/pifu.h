/* pifu: the networks of PIFu with colour (Saito et al., ICCV 2019), with batch norms, bilinear resizing and
 * one picture: occupancy and colour at pixels and depths. settings.h has what makes a model of them. */
#ifndef SHERF_PIFU_H
#define SHERF_PIFU_H

#include "nn/layers.h"

enum { PIFU_STACKS = 4, PIFU_HIDDEN = 4, PIFU_BLOCKS = 6, PIFU_HOURGLASS = 7 };
typedef struct {
    int stacks, width; /* of the geometry's filter: 4, 256 */
    int color_width;   /* of the first layer of the colour's filter: 64; its map has four times as many */
    int hidden[PIFU_HIDDEN]; /* of both point networks: 1024, 512, 256, 128; 0 ends them earlier */
} pifu_sizes;
extern const pifu_sizes pifu_paper; /* the authors' */

/* Norm, ReLU and a 3 x 3 convolution, three times, each as wide as the one before or half as wide. Their
 * outputs, side by side, are added to the input. */
typedef struct {
    batch_norm norm[3], way_norm;
    tensor *conv[3], *way; /* way: 1 x 1, where the widths differ, else NULL */
} pifu_block;
typedef struct {
    tensor *w, *b; /* 1 x 1 with bias */
} pifu_mix;
typedef struct {
    pifu_block hourglass[PIFU_HOURGLASS], last;
    pifu_mix mix, out, features_back, out_back; /* the last two between stacks */
    batch_norm norm;
} pifu_stack;
typedef struct {
    linear_layer layer[PIFU_HIDDEN + 1];
    int layers;
} pifu_points;
typedef struct {
    tensor *conv[2];
    batch_norm norm[2]; /* the very last block has one */
} pifu_residual;
typedef struct {
    pifu_sizes sizes;
    tensor *stem, *stem_bias;
    batch_norm stem_norm;
    pifu_block block[3];
    pifu_stack stack[PIFU_STACKS];
    pifu_points occupancy;
    tensor *color_conv[3];
    batch_norm color_norm[3];
    pifu_residual residual[PIFU_BLOCKS];
    pifu_points color;
} pifu_network;

void pifu_declare(declaration *d, const pifu_sizes *sizes, pifu_network *out);
/* The picture [H, W, 3] in [-1, 1], H and W multiples of 16, to a map [H/4, W/4, width] of each stack. NULL
 * with the tape's status after a failure. */
tensor *pifu_maps(tape *t, const pifu_network *n, tensor *image, tensor *map[PIFU_STACKS]);
/* The picture to [H/4, W/4, 4 color_width]. */
tensor *pifu_color_map(tape *t, const pifu_network *n, tensor *image);
/* uv [P, 2] in [-1, 1], corners of the picture at the corners of the map; z [P, 1]: 2.25 times the depth
 * behind the root over the person's height. -> [P, 1] in (0, 1). */
tensor *pifu_occupancy(tape *t, const pifu_network *n, tensor *map, const float *uv, tensor *z,
                       int64_t count);
/* -> [P, 3] in (-1, 1). map: of the last stack; the colour's loss must not train it. */
tensor *pifu_color(tape *t, const pifu_network *n, tensor *map, tensor *color_map, const float *uv, tensor *z,
                   int64_t count);

#endif
