/* Trains a tiny model on tube people and reads the log. */
#ifndef TEST_TUBE_TRAINING_H
#define TEST_TUBE_TRAINING_H

#include <math.h>
#include <stdio.h>

#include "io/value.h"
#include "support.h"

#define TINY                                                                                                 \
    "small,encoder_width=8,style_width=16,plane_resolution=16,channel_base=256,channel_max=16,"              \
    "volume_channels0=8,volume_channels1=8,volume_channels2=8,decoder_width=16,decoder_depth=2,"             \
    "decoder_skip=0,view_width=16,voxel_size_m=0.05"

static char root[512]; /* folder of the data set */

/* A path in the data set's folder; static storage, 64 at a time. */
static inline const char *path_of(const char *name) {
    static char path[64][1024];
    static int next;
    next = (next + 1) % 64;
    snprintf(path[next], sizeof path[next], "%s/%s", root, name);
    return path[next];
}

static inline sherf_status tubes_make(context *c, const sherf_synth_options *synth) {
    snprintf(root, sizeof root, "%s", test_path("data"));
    const sherf_status status = sherf_synth_tube(c, root, synth);
    if (status != SHERF_OK) fprintf(stderr, "%s\n", c->message);
    return status;
}

/* Valid until the next call. */
static inline sherf_train_options tube_training(const char *preset, const char *output, int64_t steps) {
    static char spec[600], body[600];
    snprintf(spec, sizeof spec, "thuman:%s", root);
    snprintf(body, sizeof body, "%s/tubeman.safetensors", root);
    return (sherf_train_options){.data = spec,
                                 .people = "0-1",
                                 .body = body,
                                 .output = output,
                                 .preset = preset,
                                 .steps = steps,
                                 .batch = 4,
                                 .targets = 2,
                                 .seed = 11,
                                 .background = "random",
                                 .sample_every = 1000};
}

/* A number in a line (counted from 1) of a training's log; NaN for null. */
static inline double logged(context *c, const char *folder, int line, const char *key) {
    char path[1200], text[4096];
    snprintf(path, sizeof path, "%s/log.jsonl", folder);
    FILE *f = fopen(path, "r");
    assert_non_null(f);
    for (int i = 0; i < line; i++) assert_non_null(fgets(text, sizeof text, f));
    fclose(f);
    document *d;
    assert_ok(c, json_parse(c, text, strlen(text), &d));
    const value *got = value_get(d->root, key);
    assert_non_null(got);
    const double v = got->kind == VALUE_REAL      ? got->real
                     : got->kind == VALUE_INTEGER ? (double)got->integer
                                                  : NAN;
    document_free(d);
    return v;
}

#endif
