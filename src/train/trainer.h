/* trainer: steps of forward, backward and Adam over images that the loader brings. */
#ifndef SHERF_TRAINER_H
#define SHERF_TRAINER_H

#include "model/model.h"
#include "train/adam.h"
#include "train/checkpoint.h"
#include "train/history.h"
#include "train/loader.h"
#include "train/ranks.h"

/* ---- one image (image.c) ---- */
/* Forward, losses, and the gradients of total * scale added to the parameters'. The batch norms' running
 * statistics move. The tape is reset first. */
sherf_status image_gradients(tape *t, const model *m, const body_model *body, const loss_networks *networks,
                             const sample *s, double scale, loss_values *values);

/* ---- the sum of a step (total.c) ----
 * Gradients, running statistics and losses of a step's images, added up so that the result is the same bits
 * for any number of processes: the gradients as a binary tree over the images, in which a process with a
 * contiguous share of 2^k images owns a whole branch; the rest kept by image and summed in order. The running
 * statistics of a step are the mean of what each of its images alone would have made of them. */
typedef struct {
    parameters *weights;
    int images;     /* of a step, over all processes */
    int begin, end; /* this process's */
    int levels;
    float **branch;  /* levels, trained_floats each: finished branches of 2^level images; made on demand */
    bool *full;      /* levels: the branch holds something */
    int64_t buffers; /* floats behind the trained ones */
    float *before;   /* running statistics at the start of the step */
    float *by_image; /* images x (buffers + TOTAL_LOSSES) */
} step_total;
enum { TOTAL_LOSSES = 6 };
sherf_status total_create(context *c, parameters *weights, int images, int begin, int end, step_total *out);
void total_free(step_total *s);
void total_start(step_total *s); /* zeroes gradients */
/* Takes over image number `image`, whose gradients are in the parameters' block, and makes ready for the
 * next. */
sherf_status total_add(context *c, step_total *s, int image, const loss_values *values);
/* Sums over images and ranks: the gradients end in the parameters' block, the statistics in the model. */
sherf_status total_finish(context *c, step_total *s, const ranks *r, loss_values *mean);
void total_undo(step_total *s); /* running statistics as before the step */

#endif
