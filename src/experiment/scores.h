/* scores: the scores of each person in scorings' scores.json. */
#ifndef SHERF_EXPERIMENT_SCORES_H
#define SHERF_EXPERIMENT_SCORES_H

#include "experiment/interval.h"

/* What is scored: pictures of novel views, pictures of novel poses, and the surfaces of methods that make
 * some. */
typedef enum { SCORED_VIEW, SCORED_POSE, SCORED_SURFACE, SCORED_PARTS } scored_part;
enum {
    METRIC_PSNR,
    METRIC_SSIM,
    METRIC_LPIPS,
    METRIC_RESNET50,
    PICTURE_METRICS, /* the others are of surfaces */
    METRIC_CHAMFER = PICTURE_METRICS,
    METRIC_TO_TRUTH,
    METRIC_FROM_TRUTH,
    METRIC_NORMAL,
    METRIC_OVERLAP,
    METRICS
};
typedef struct {
    const char *key, *label;
    int decimals, better; /* as page_column's */
} score_metric;
extern const score_metric score_metrics[METRICS];

typedef struct {
    char *name;                         /* owned */
    int count[SCORED_PARTS];            /* of pictures, of surfaces */
    double mean[SCORED_PARTS][METRICS]; /* NaN: none */
} person_scores;
typedef struct {
    int person; /* of scores.person */
    int observed_pose, observed_view, pose, view;
    bool novel_pose;
    double psnr;
} picture_scores;
typedef struct {
    int people, pictures;
    person_scores *person;         /* owned */
    picture_scores *picture;       /* owned */
    int estimates, missed;         /* number of estimated bodies; of pictures in which nobody was found */
    double aligned_mm;             /* their mean error; NaN: none were estimated */
    int surfaces, surfaces_missed; /* number compared; of observations without one */
} scores;
void scores_free(scores *s); /* its arrays; fine on zeroes */
/* Refuses a file that no evaluation wrote. */
sherf_status scores_read(context *c, const char *path, scores *out);

/* For `count` scorings of the same people (seeds): the mean over pictures or surfaces, with its interval over
 * people; a person's value is the mean over the scorings. minus (NULL: none): gives the difference to these
 * instead. */
sherf_status scores_interval(context *c, const scores *of, const scores *minus, int count, scored_part part,
                             int metric, interval *out);

#endif
