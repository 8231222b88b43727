/* A tube person's avatar with a network of constant density: its surface is that of the shell, about 5 cm off
 * the body. */
#ifndef TESTS_SOLID_AVATAR_H
#define TESTS_SOLID_AVATAR_H

#include "data/data.h"
#include "model/model.h"
#include "support.h"

enum { SOLID_SIDE = 64, SOLID_DENSITY = 60 };

/* in the test's folder people/, which also has the body */
static inline sherf_status solid_avatar_make(context *c, body_model **body, sherf_avatar **avatar) {
    char root[600], path[700];
    sherf_dataset *data = NULL;
    sherf_observation *observation = NULL;
    sherf_model *m = NULL;
    snprintf(root, sizeof root, "%s", test_path("people"));
    snprintf(path, sizeof path, "%s/tubeman.safetensors", root);
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 4, .size_px = SOLID_SIDE, .seed = 5};
    sherf_status status = sherf_synth_tube(c, root, &synth);
    if (!status) status = body_load(c, path, body);
    snprintf(path, sizeof path, "thuman:%s", root);
    if (!status) status = sherf_dataset_open(c, path, &data);
    if (!status) status = sherf_dataset_observation(c, data, 0, 0, 0, &observation);
    if (!status)
        status = sherf_model_create(
            c, "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16", 3, &m);
    if (!status) {
        tensor *w = model_tensor(m, "decoder.alpha_linear.weight"),
               *b = model_tensor(m, "decoder.alpha_linear.bias");
        memset(w->data, 0, (size_t)tensor_count(w) * sizeof(float));
        *tensor_f32(b) = SOLID_DENSITY;
        status = sherf_avatar_create(c, m, *body, observation, avatar);
    }
    if (status) fprintf(stderr, "%s\n", c->message);
    sherf_model_free(m);
    sherf_observation_free(observation);
    sherf_dataset_free(data);
    return status;
}

#endif
