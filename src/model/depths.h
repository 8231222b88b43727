/* depths: the depths of samples on a ray for models other than SHERF. Results lie in the tape's memory and
 * depend on the key alone. Key 0 is for frames to look at and to score, which are the same each time. */
#ifndef SHERF_DEPTHS_H
#define SHERF_DEPTHS_H

#include "model/model.h"

/* Stratified depths for points_of_box's samples: sample i of S lies at random in interval i of S equal ones
 * of [near, far]; with key 0 in its middle. NULL: the tape says why. */
point_set *depths_stratified(tape *t, const point_set *points, uint64_t key);

/* Each even sample is moved at random within the halfway points to its neighbours. last_way: the distance
 * behind a ray's last sample. */
point_set *depths_jittered(tape *t, const point_set *points, float last_way, uint64_t key);

/* What a second pass draws (PixelNeRF): `drawn` depths from intervals of [near, far] with probabilities by
 * the first pass's weights, and `around` more at the mean depth, with normal noise of spread_m metres. */
typedef struct {
    int drawn, around;
    float spread_m;
} fine_draw;
/* The stratified samples, which have raw density sigma [P, 1], together with the drawn ones, sorted on each
 * ray. Key 0: the drawn depths are the quantiles (j + 0.5) / drawn. Waits for sigma. */
point_set *depths_fine(tape *t, const point_set *coarse, const tensor *sigma, fine_draw draw, uint64_t key);

#endif
