/* losses: the terms that training minimises (network.md, Training). */
#ifndef SHERF_LOSSES_H
#define SHERF_LOSSES_H

#include "model/model.h"
#include "nn/lpips.h"
#include "nn/resnet50.h"

/* What a frame is compared with. Pixels that are `unknown` take no part. */
typedef struct {
    int width, height;
    const float *image;     /* H x W x 3 */
    const uint8_t *mask;    /* H x W, 1: the person */
    const uint8_t *unknown; /* H x W, or NULL */
    const uint8_t *at_box;  /* H x W, rays that meet the target's box */
    float background; /* grey in [0, 1]: the colour outside the mask, over which the frame was composited */
    const training_recipe *recipe; /* NULL: SHERF's losses */
    tensor *coarse;                /* [N, 5] of a first pass, or NULL */
} loss_target;

/* Terms of SHERF's loss, as bits; PERCEPTUAL is LPIPS or the resnet50 distance. */
enum { LOSS_COLOR = 1, LOSS_MASK = 2, LOSS_SSIM = 4, LOSS_PERCEPTUAL = 8, LOSS_ALL = 15 };
/* Bits of "mask,ssim": color, mask, ssim, perceptual, and not all of them; "" and NULL: 0. */
sherf_status losses_parse(context *c, const char *list, unsigned *out);

/* Networks of the perceptual losses; each may be NULL, and its term is then left out. */
typedef struct {
    const lpips_network *lpips;
    const resnet50_network *resnet50;
    double resnet50_weight; /* 0: losses_resnet50_weight */
    unsigned without;       /* terms that are left out; colour and mask are still computed and reported */
} loss_networks;
/* At the paper's 24.7 dB its LPIPS is 0.10, and the distance of people blurred, bent or tinted to that PSNR
 * is 0.14 to 0.55, 0.31 in the geometric mean: so both terms weigh about the same (docs/training.md). */
static const double losses_resnet50_weight = 0.3;

enum { LOSSES = 6 };
typedef struct {
    double total, color, mask, ssim, lpips, resnet50; /* ssim: SSIM itself; not computed: NaN */
} loss_values;

/* The same as scalars of the tape, NULL where not computed. */
typedef struct {
    tensor *total; /* the loss to differentiate: without the 1 of 1 - ssim */
    tensor *color, *mask, *ssim, *lpips, *resnet50;
} loss_tensors;

/* frame [N, 5] of model_frame. total = 100 color + 10 mask + (1 - ssim) + lpips: colour, 0.1 mask,
 * 0.01 (1 - SSIM), 0.01 LPIPS, times the 100 of the authors' code; + weight resnet50 where that network is
 * given. ssim and the networks' distances are taken on the bounding rectangle of the rays at the box where it
 * is large enough. With a recipe: its losses alone, the colour of a first pass added. `networks` may be NULL.
 * All of them are NULL when no ray meets the box. */
sherf_status losses_forward(tape *t, const loss_networks *networks, tensor *frame, const loss_target *target,
                            loss_tensors *out);
/* Puts them into row, LOSSES floats in the memory of the tape's backend, without waiting. */
sherf_status losses_store(tape *t, const loss_tensors *losses, float *row);
/* The losses in such a row; all 0, or NaN, where no ray met the box. */
loss_values losses_values(const float row[LOSSES]);

#endif
