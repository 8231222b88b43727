/* loader: threads that read the pictures of the coming samples and prepare their geometry, so that a step
 * never waits for files. */
#ifndef SHERF_LOADER_H
#define SHERF_LOADER_H

#include "eval/estimated.h"
#include "model/model.h"
#include "train/surfaces.h"

typedef struct {
    draw drawn;
    data_view *observation, *target;
    observation_geometry *observation_geometry;
    target_geometry *target_geometry;
    struct {
        data_view *target;
        target_geometry *geometry;
    } more[TARGETS_MAX - 1]; /* drawn.further of them */
    surface_draw surface;    /* of a model that learns from surfaces, which has no targets */
} sample;
void sample_free(sample *s); /* its parts; fine on zeroes */

typedef struct {
    const sherf_dataset *data;
    const body_model *body;
    const model_config *config;
    const eval_estimator *estimator; /* for samples that are observed by estimate; used by many threads */
    int width;                       /* 0: the protocol's */
} sample_source;
/* Loads one sample synchronously; sizes as in sherf_train_options. If its observation is estimated, the
 * targets' cameras and poses are mapped to the estimate's world, as in evaluation; if nobody is found, the
 * data set's observation is used. */
sherf_status sample_load(context *c, const sample_source *source, draw drawn, sample *out);

typedef struct {
    sample_source source;
    const sampling *sampling;
    int64_t first_step;    /* samples from this step on */
    int batch, begin, end; /* of each step, the samples [begin, end) */
    int workers;           /* at least 1 */
} loader_options;

typedef struct loader loader;
/* What options point to must outlive the loader. */
sherf_status loader_create(context *c, const loader_options *options, loader **out);
void loader_free(loader *l);
/* The next sample in order, whatever the number of workers; it is the caller's (sample_free). */
sherf_status loader_next(context *c, loader *l, sample *out);
double loader_waited(const loader *l); /* total seconds that loader_next waited */

#endif
