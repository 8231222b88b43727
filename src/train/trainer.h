/* trainer: steps of forward, backward and Adam over samples that the loader brings. */
#ifndef SHERF_TRAINER_H
#define SHERF_TRAINER_H

#include "model/model.h"
#include "train/adam.h"
#include "train/buckets.h"
#include "train/checkpoint.h"
#include "train/history.h"
#include "train/loader.h"
#include "train/ranks.h"

/* ---- one sample (sample.c) ---- */
/* Forward, losses, and the gradients of total * scale added to the parameters'. The batch norms' running
 * statistics move. The tape is reset first. rows: losses of each target, LOSSES floats (losses_store), in the
 * memory of the tape's backend, which nobody waits for here. */
sherf_status sample_gradients(tape *t, const model *m, const body_model *body, const loss_networks *networks,
                              const sample *s, double scale, float *rows);

/* ---- the sum of a step (total.c) ----
 * Gradients, running statistics and losses of a step's samples, added up so that the result is the same bits
 * for any number of processes: the gradients as a binary tree over the samples, in which a process with a
 * contiguous share of 2^k samples owns a whole branch; the rest kept by sample and summed in order. The
 * running statistics of a step are the mean of what each of its samples alone would have made of them. All
 * lies where the weights lie, but for the losses' means. */
typedef struct {
    parameters *weights;
    int samples;    /* of a step, over all processes */
    int begin, end; /* this process's */
    int targets;    /* of a sample, at most */
    int levels;
    float **branch;    /* levels, trained_floats each: finished branches of 2^level samples; made on demand */
    bool *full;        /* levels: the branch holds something */
    int64_t buffers;   /* number of floats after the trained ones */
    float *before;     /* running statistics at the start of the step */
    float *statistics; /* samples x buffers */
    float *rows;       /* (end - begin) x targets x LOSSES */
    float *losses;     /* of the host: samples x LOSSES, means over the targets; made by total_finish */
    buckets *buckets;  /* of processes with a GPU each; else NULL */
} step_total;
sherf_status total_create(context *c, parameters *weights, int samples, int begin, int end, int targets,
                          step_total *out);
/* If the processes have joined a group, their sums start in the backward pass of the last sample. Neither the
 * total nor the ranks may move in memory from now on. */
sherf_status total_overlap(context *c, step_total *s, const ranks *r);
void total_free(step_total *s);
sherf_status total_start(context *c, step_total *s); /* zeroes gradients */
/* Where the losses of a sample of this process go: for sample_gradients. */
float *total_rows(const step_total *s, int number);
/* Before sample_gradients of that sample on this tape. */
void total_watch(step_total *s, tape *t, int number);
/* Takes over sample `number`, whose gradients are in the parameters' block, and prepares for the next. */
sherf_status total_add(context *c, step_total *s, int number);
/* Sums over samples and ranks: the gradients end in the parameters' block, the statistics in the model. Waits
 * for the losses. */
sherf_status total_finish(context *c, step_total *s, const ranks *r, loss_values *mean);
sherf_status total_undo(context *c, step_total *s); /* running statistics as before the step */

#endif
