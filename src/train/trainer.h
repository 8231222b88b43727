/* trainer: steps of forward, backward and Adam over images that the loader brings. */
#ifndef SHERF_TRAINER_H
#define SHERF_TRAINER_H

#include "model/model.h"
#include "train/adam.h"
#include "train/buckets.h"
#include "train/checkpoint.h"
#include "train/history.h"
#include "train/loader.h"
#include "train/ranks.h"

/* ---- one image (image.c) ---- */
/* Forward, losses, and the gradients of total * scale added to the parameters'. The batch norms' running
 * statistics move. The tape is reset first. rows: losses of each target, LOSSES floats (losses_store), in the
 * memory of the tape's backend, which nobody waits for here. */
sherf_status image_gradients(tape *t, const model *m, const body_model *body, const loss_networks *networks,
                             const sample *s, double scale, float *rows);

/* ---- the sum of a step (total.c) ----
 * Gradients, running statistics and losses of a step's images, added up so that the result is the same bits
 * for any number of processes: the gradients as a binary tree over the images, in which a process with a
 * contiguous share of 2^k images owns a whole branch; the rest kept by image and summed in order. The running
 * statistics of a step are the mean of what each of its images alone would have made of them. All lies where
 * the weights lie, but for the losses' means. */
typedef struct {
    parameters *weights;
    int images;     /* of a step, over all processes */
    int begin, end; /* this process's */
    int targets;    /* of an image, at most */
    int levels;
    float **branch;    /* levels, trained_floats each: finished branches of 2^level images; made on demand */
    bool *full;        /* levels: the branch holds something */
    int64_t buffers;   /* floats behind the trained ones */
    float *before;     /* running statistics at the start of the step */
    float *statistics; /* images x buffers */
    float *rows;       /* (end - begin) x targets x LOSSES */
    float *losses;     /* of the host: images x LOSSES, means over the targets; made by total_finish */
    buckets *buckets;  /* of processes with a GPU each; else NULL */
} step_total;
sherf_status total_create(context *c, parameters *weights, int images, int begin, int end, int targets,
                          step_total *out);
/* Sums over these processes begin in the backward pass of the last image, where they have joined a group.
 * Neither the total nor the ranks may move from now on. */
sherf_status total_overlap(context *c, step_total *s, const ranks *r);
void total_free(step_total *s);
sherf_status total_start(context *c, step_total *s); /* zeroes gradients */
/* Where the losses of an image of this process go: for image_gradients. */
float *total_rows(const step_total *s, int image);
/* Before image_gradients of that image on this tape. */
void total_watch(step_total *s, tape *t, int image);
/* Takes over image number `image`, whose gradients are in the parameters' block, and makes ready for the
 * next. */
sherf_status total_add(context *c, step_total *s, int image);
/* Sums over images and ranks: the gradients end in the parameters' block, the statistics in the model. Waits
 * for the losses. */
sherf_status total_finish(context *c, step_total *s, const ranks *r, loss_values *mean);
sherf_status total_undo(context *c, step_total *s); /* running statistics as before the step */

#endif
