/* selection: the pictures that an evaluation uses, from the command line or the paper's protocol. */
#ifndef SHERF_SELECTION_H
#define SHERF_SELECTION_H

#include "data/data.h"

typedef struct {
    int pose, view;
} picture;

/* "0,2,5" or "first:step:count", also mixed. Every number is in [0, limit), none comes twice. `what` names
 * the list in messages. *out is mem_free'd. */
sherf_status selection_list(context *c, const char *text, const char *what, int limit, int **out, int *count);
/* "POSE:VIEW,POSE:VIEW". */
sherf_status selection_pictures(context *c, const char *text, int poses, int views, picture **out,
                                int *count);

/* One person's part of an evaluation. An observation (p, v) is compared with every view of pose p except v
 * (novel view) if p is among the first `view_poses` poses. It is compared with every view of the other poses
 * from `novel_pose_first` on (novel pose) if its `novel_pose` is set. */
typedef struct {
    int person; /* of the data set */
    int observations, poses, views;
    picture *observation;
    bool *novel_pose;
    int *pose, *view;
    int view_poses;       /* 0: all */
    int novel_pose_first; /* number of a pose */
    bool one_pose;        /* no novel pose is compared; set by the caller */
    int pictures;  /* of an observation; 0 means 1; further ones are from views spaced evenly around; set by
                      the caller */
    int all_views; /* views that the person has */
} selection;

/* observations, poses, views as in sherf_eval_options. seed: for random observations, each one of the
 * person's listed poses from any view, independent of the other people. NULL selects the paper's protocol:
 * each of its poses is observed from each of its observation views, and novel poses are the `pose_count` - 1
 * that follow one of them, rendered from that one. Pictures that the person does not have are left out with a
 * warning. */
sherf_status selection_create(context *c, const sherf_dataset *d, int person, const char *observations,
                              const char *poses, const char *views, uint64_t seed, selection *out);
bool selection_is_random(const char *observations);
void selection_free(selection *s); /* its arrays; fine on zeroes */
/* The picture number k of observation i, from 0. */
picture selection_picture(const selection *s, int i, int k);
/* Whether `target` is compared with observation i; *novel_pose says which score it belongs to. */
bool selection_target(const selection *s, int i, picture target, bool *novel_pose);
int64_t selection_pairs(const selection *s);

#endif
