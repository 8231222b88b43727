/* estimated: evaluating with bodies and cameras that were estimated from the observed picture alone.
 *
 * An estimate has its own world. The truth is mapped to it: directions through the observed camera, in whose
 * frame both worlds are known, and positions so that the true body's pelvis coincides with the estimate's. */
#ifndef SHERF_ESTIMATED_H
#define SHERF_ESTIMATED_H

#include "data/data.h"
#include "estimate/estimate.h"
#include "eval/pose_error.h"
#include "eval/selection.h"

/* Makes an observation of the same size in pixels from a picture with its background; *out NULL: nobody was
 * found. truth is for tests, which modify it. */
typedef struct {
    sherf_status (*estimate)(context *c, void *state, const sherf_image *photo,
                             const sherf_observation *truth, sherf_observation **out);
    void *state;
} eval_estimator;
/* That of estimate/: the state is a photo_estimator. */
typedef struct {
    sherf_estimator *networks;
    const sherf_body *body;
} photo_estimator;
sherf_status estimate_by_photo(context *c, void *state, const sherf_image *photo,
                               const sherf_observation *truth, sherf_observation **out);
/* Estimates from the data set's picture at its own size and scales the result to the size of truth, which was
 * read from it; *out NULL: nobody was found. */
sherf_status estimated_observation(context *c, const eval_estimator *e, const sherf_dataset *d, int person,
                                   int pose, int view, const sherf_observation *truth,
                                   sherf_observation **out);

/* ---- carrying over ---- */
typedef struct {
    bool same; /* the estimate has the truth's camera and body to the bit: nothing is moved */
    double scale, R[9], t_m[3]; /* x_estimate = scale R x_truth + t */
    sherf_pose pose;            /* the estimate's */
} carried;
sherf_status carried_create(context *c, const body_model *body, const sherf_observation *truth,
                            const sherf_observation *estimate, carried *out);
void carried_camera(const carried *w, const sherf_camera *truth, sherf_camera *out);
/* The truth's joint rotations with the estimate's shape; the pelvis is where the true one is mapped to. own:
 * the estimate's own pose, where it was observed. */
sherf_status carried_pose(context *c, const carried *w, const body_model *body, const sherf_pose *truth,
                          bool own, sherf_pose *out);

/* ---- errors ---- */
sherf_status estimated_error(context *c, const body_model *body, const sherf_observation *truth,
                             const sherf_observation *estimate, pose_error *out);

typedef struct {
    int person;
    picture observation;
    pose_error error;
} estimate_entry;
typedef struct {
    int64_t count, capacity;
    estimate_entry *entry; /* by person */
    int missed;            /* pictures in which nobody was found */
} estimate_list;
sherf_status estimate_list_add(context *c, estimate_list *l, const estimate_entry *e);
void estimate_list_free(estimate_list *l);
/* Of one person, or all (-1). */
typedef struct {
    int count, wrong_way;
    pose_error mean, worst;
} estimate_summary;
estimate_summary estimate_list_summary(const estimate_list *l, int person);
/* Text to print below the scores; mem_free it. NULL: out of memory. */
char *estimate_list_table(context *c, const estimate_list *l, const sherf_dataset *d);

#endif
