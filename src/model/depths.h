/* depths: where models other than SHERF have their samples on a ray. All in the tape's memory, and functions
 * of the key alone; key 0 is for frames to look at and to score, which are the same each time. */
#ifndef SHERF_DEPTHS_H
#define SHERF_DEPTHS_H

#include "model/model.h"

/* As points_of_box made them, sample i of S anywhere in part i of the S equal parts of [near, far]; with key
 * 0 in its middle. NULL: the tape says why. */
point_set *depths_stratified(tape *t, const point_set *points, uint64_t key);

/* Anywhere between the middles to the even samples before and behind. last_way: behind a ray's last sample.
 */
point_set *depths_jittered(tape *t, const point_set *points, float last_way, uint64_t key);

/* What a second pass draws (PixelNeRF): `drawn` depths from the parts of [near, far], as likely as the
 * samples weigh, and `around` of them at the mean depth, with normal noise of spread_m metres. */
typedef struct {
    int drawn, around;
    float spread_m;
} fine_draw;
/* The stratified samples, whose raw density sigma [P, 1] is, and those; in order on each ray. Key 0: the
 * drawn ones are the quantiles (j + 0.5) / drawn. Waits for sigma. */
point_set *depths_fine(tape *t, const point_set *coarse, const tensor *sigma, fine_draw draw, uint64_t key);

#endif
