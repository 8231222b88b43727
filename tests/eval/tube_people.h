/* Small tube people, their body and a made-up model, and how scores.json is read. */
#ifndef TEST_TUBE_PEOPLE_H
#define TEST_TUBE_PEOPLE_H

#include <math.h>
#include <stdio.h>

#include "data/data.h"
#include "support.h"

typedef struct {
    char spec[600], body[600], weights[600]; /* the data set's spec; files */
} tube_people;

static inline sherf_status tube_people_make(context *c, const char *root, const sherf_synth_options *synth,
                                            tube_people *out) {
    sherf_model *m = NULL;
    snprintf(out->spec, sizeof out->spec, "thuman:%s", root);
    snprintf(out->body, sizeof out->body, "%s/tubeman.safetensors", root);
    snprintf(out->weights, sizeof out->weights, "%s/model.safetensors", root);
    sherf_status status = sherf_synth_tube(c, root, synth);
    if (!status)
        status = sherf_model_create(
            c, "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16", 3, &m);
    if (!status) status = sherf_model_save(c, m, out->weights);
    sherf_model_free(m);
    if (status) fprintf(stderr, "%s\n", c->message);
    return status;
}

/* NaN for null. */
static inline double number(const value *o, const char *key) {
    const value *v = value_get(o, key);
    assert_non_null(v);
    return v->kind == VALUE_REAL ? v->real : v->kind == VALUE_INTEGER ? (double)v->integer : NAN;
}

#endif
