/* history: the results of every step, as lines of log.jsonl and as the picture loss.png. */
#ifndef SHERF_HISTORY_H
#define SHERF_HISTORY_H

#include <stdio.h>

#include "train/losses.h"

typedef struct {
    int64_t step; /* from 1 */
    loss_values loss;
} history_point;

typedef struct {
    FILE *file;
    int64_t count, capacity;
    history_point *point;
} history;

/* Opens the log for lines after `step`; lines of later steps (made after the checkpoint that is continued)
 * are dropped, earlier ones are read in. */
sherf_status history_open(context *c, const char *path, int64_t step, history *out);
typedef struct {
    double rate, seconds, eta_seconds, waited_seconds;
    bool skipped;
} history_extra;
sherf_status history_add(context *c, history *h, history_point p, const history_extra *extra);
void history_close(history *h);
/* Loss over steps, logarithmic: every step pale, the running mean dark, its parts beside it. */
sherf_status history_plot(context *c, const history *h, const char *path);

#endif
