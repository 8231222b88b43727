/* checkpoint: everything that a training needs to continue with the same bits, in one safetensors file. */
#ifndef SHERF_TRAIN_CHECKPOINT_H
#define SHERF_TRAIN_CHECKPOINT_H

#include "model/model.h"
#include "train/adam.h"
#include "train/draw.h"
#include "train/losses.h"

enum { BATCH_MAX = 65536 };

/* The number of steps made, and all settings that the following steps depend on. */
typedef struct {
    int64_t step, skipped; /* skipped: steps without an update, their gradients were not finite */
    uint64_t seed;
    int batch, size_px, front_view, targets, random_background, pictures;
    double learning_rate, estimated;
    int64_t halve_every;
    double beta2;     /* Adam's; 0: the model's */
    unsigned without; /* terms that the loss leaves out, LOSS_COLOR and so on */
} train_state;

/* Adam with the settings of the model's recipe (model_recipe), in the host's memory; beta2 0: the
 * recipe's. */
sherf_status adam_of_model(context *c, const model *m, double beta2, adam *out);
/* The tensors: model.NAME, average.NAME (moving average), second.NAME and, where beta1 is
 * not 0, first.NAME (Adam's moments). The metadata:
 * format=sherf-checkpoint, config, and the state. The arrays may be in any memory; the file does not tell. */
sherf_status checkpoint_write(context *c, const char *path, const model *m, const model *average,
                              const adam *a, const train_state *state);
/* Makes both models and the optimiser's state, in the host's memory. */
sherf_status checkpoint_read(context *c, const char *path, model **m, model **average, adam *a,
                             train_state *state);

#endif
