/* adam: the optimiser, its schedule and the moving average, over plain arrays (nn/parameters.h). */
#ifndef SHERF_ADAM_H
#define SHERF_ADAM_H

#include "tensor/block.h"

/* Adam. As SHERF is trained beta1 is 0: the first moment is the gradient itself, so that only the second is
 * kept. m <- b1 m + (1 - b1) g; v <- b2 v + (1 - b2) g^2;
 * x <- x - rate m / (1 - b1^t) / (sqrt(v / (1 - b2^t)) + eps). */
static const double adam_beta1 = 0, adam_beta2 = 0.99, adam_eps = 1e-8;
typedef struct {
    int64_t n;
    double beta1, beta2;
    float *first;                /* as `second`; NULL where beta1 is 0 */
    const tensor_memory *memory; /* where these arrays and those passed to it lie; NULL: the host's memory */
    float *second;               /* n, zero before the first update; owned */
    double *sums;                /* SQUARE_SUMS, in that memory; owned */
    int64_t updates;
} adam;
sherf_status adam_create(context *c, int64_t n, adam *out); /* in the host's memory */
sherf_status adam_create_with(context *c, int64_t n, double beta1, double beta2, adam *out);
void adam_free(adam *a);
/* Moves it into another memory. NULL: it stays. */
sherf_status adam_place(context *c, adam *a, const tensor_memory *memory);
sherf_status adam_step(context *c, adam *a, float *values, const float *gradients, double rate);

/* The sum of squares, in double, in an order that does not depend on the thread count. Not finite when any
 * gradient is not. Waits for it. */
sherf_status gradients_square_sum(context *c, const adam *a, const float *gradients, double *out);

/* rate / 2^floor(step / halve_every). */
double schedule_rate(double rate, int64_t step, int64_t halve_every);

/* Exponential moving average: old values lose half their weight in `half_life` steps, min(312.5, 5 % of the
 * steps so far). That is StyleGAN's choice (10 000 / 32 steps, with a ramp); the ramp keeps the beginning
 * from dominating short trainings. average <- value + decay (average - value), decay 0.5^(1 / half_life). */
double average_decay(int64_t step);
sherf_status average_update(context *c, const tensor_memory *memory, int64_t n, float *average,
                            const float *values, double decay);

#endif
