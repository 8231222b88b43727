/* scores: what scorings left in their scores.json, by person. */
#ifndef SHERF_EXPERIMENT_SCORES_H
#define SHERF_EXPERIMENT_SCORES_H

#include "experiment/interval.h"

enum { METRIC_PSNR, METRIC_SSIM, METRIC_LPIPS, METRIC_RESNET50, METRICS };
typedef struct {
    const char *key, *label;
    int decimals, better; /* as page_column's */
} score_metric;
extern const score_metric score_metrics[METRICS];

typedef struct {
    char *name;              /* owned */
    int count[2];            /* of pictures */
    double mean[2][METRICS]; /* novel view, novel pose; NaN: none */
} person_scores;
typedef struct {
    int person; /* of scores.person */
    int observed_pose, observed_view, pose, view;
    bool novel_pose;
    double psnr;
} picture_scores;
typedef struct {
    int people, pictures;
    person_scores *person;   /* owned */
    picture_scores *picture; /* owned */
    int estimates, missed;   /* bodies that were estimated; pictures in which nobody was found */
    double aligned_mm;       /* what they are off by on average; NaN: none were */
} scores;
void scores_free(scores *s); /* its arrays; fine on zeroes */
/* Refuses a file that is not of an evaluation. */
sherf_status scores_read(context *c, const char *path, scores *out);

/* Of `count` scorings of the same people (seeds): the mean over pictures, with its interval over people,
 * whose values are means over the scorings. minus (NULL: none): the difference to these. */
sherf_status scores_interval(context *c, const scores *of, const scores *minus, int count, bool novel_pose,
                             int metric, interval *out);

#endif
