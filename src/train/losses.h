/* losses: what the network is trained to make small (network.md, Training). */
#ifndef SHERF_LOSSES_H
#define SHERF_LOSSES_H

#include "nn/lpips.h"

/* What a frame is compared with. Pixels that are `unknown` take no part. */
typedef struct {
    int width, height;
    const float *image;     /* H x W x 3 */
    const uint8_t *mask;    /* H x W, 1: the person */
    const uint8_t *unknown; /* H x W, or NULL */
    const uint8_t *at_box;  /* H x W, rays that meet the target's box */
} loss_target;

typedef struct {
    double total, color, mask, ssim, lpips; /* ssim: SSIM itself; not computed: NaN */
} loss_values;

/* frame [N, 5] of model_frame. total = 100 color + 10 mask + (1 - ssim) + lpips: colour, 0.1 mask,
 * 0.01 (1 - SSIM), 0.01 LPIPS, times the 100 of the authors' code. ssim and lpips are taken on the bounding
 * rectangle of the rays at the box where it is large enough; lpips needs its network (NULL: left out).
 * *total is the scalar to go back from; NULL, with values of 0, when no ray meets the box. */
sherf_status losses_forward(tape *t, const lpips_network *lpips, tensor *frame, const loss_target *target,
                            tensor **total, loss_values *values);

#endif
