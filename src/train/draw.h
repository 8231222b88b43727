/* draw: chooses the pictures of each sample of a step. Sample number n (counted from the start of the
 * training, over all processes) is a pure function of the seed and n. */
#ifndef SHERF_DRAW_H
#define SHERF_DRAW_H

#include "data/data.h"
#include "model/model.h"

enum { TARGETS_MAX = 8 };

typedef struct {
    uint64_t seed;
    int people;
    int *person;     /* of the data set; owned */
    int *poses;      /* of each, on the protocol's grid; owned */
    int *views;      /* of each; owned */
    int64_t *before; /* people + 1: pictures of all people before this one; owned */
    int pose_step;
    const data_protocol *front; /* its front view observes; NULL: any view does */
    int targets;                /* of a sample, 1 to TARGETS_MAX */
    bool one_pose;              /* further targets keep the observation's pose */
    bool random_background;     /* false: always black, the paper's */
    double estimated;           /* share of the samples whose observation is estimated, 0 to 1 */
    /* from 2 on, every other sample whose observation is not estimated has 2 to this many pictures */
    int pictures;
} sampling;

/* people: as in sherf_train_options. */
sherf_status sampling_create(context *c, const sherf_dataset *d, const char *people, bool front_view,
                             int targets, uint64_t seed, sampling *out);
void sampling_free(sampling *s);
/* Target pictures: an epoch shows each of them once, in an order of its own. */
int64_t sampling_pictures(const sampling *s);

typedef struct {
    int person, pose, view; /* the target's */
    int observed_view;      /* of the same pose */
    bool estimated;         /* its camera, body and mask are estimated from its picture */
    int also; /* pictures of the observation besides the first: from distinct views, in any pose */
    struct {
        int pose, view;
    } also_of[OBSERVED_PICTURES_MAX - 1];
    int further; /* targets besides the first: any view of the person, in any pose */
    struct {
        int pose, view;
    } more[TARGETS_MAX - 1];
    uint64_t noise_key;            /* never 0 */
    float background[TARGETS_MAX]; /* grey in [0, 1] behind the target and each further one */
} draw;
draw sampling_draw(const sampling *s, int64_t number);

/* Position i of a permutation of [0, n) that `key` names, n >= 1. */
int64_t permuted(uint64_t key, int64_t i, int64_t n);

#endif
