/* The shipped model and body, and an avatar of the demo's person. */
#ifndef TEST_DEMO_SCENE_H
#define TEST_DEMO_SCENE_H

#include "avatar/avatar.h"
#include "support.h"

typedef struct {
    context *c;
    sherf_body *body;
    sherf_observation *observation;
    sherf_avatar *avatar;
    sherf_camera camera; /* the observation's */
} scene;

static inline void open_scene_of(scene *s, sherf_precision precision, const char *observation) {
    const sherf_options options = {.threads = 2, .precision = precision};
    sherf_model *m;
    sherf_observation *read;
    assert_int_equal(sherf_context_create(&options, &s->c), SHERF_OK);
    assert_ok(s->c, sherf_body_load(s->c, "../assets/body.safetensors", &s->body));
    assert_ok(s->c, sherf_model_load(s->c, "../assets/models/people.safetensors", &m));
    assert_ok(s->c, sherf_observation_load(s->c, observation, &read));
    assert_ok(s->c, sherf_observation_crop(s->c, m, s->body, read, &s->observation));
    assert_ok(s->c, sherf_avatar_create(s->c, m, s->body, s->observation, &s->avatar));
    s->camera = *sherf_observation_camera(s->observation);
    sherf_observation_free(read);
    sherf_model_free(m);
}

/* Seen from behind. */
static inline void open_scene(scene *s, sherf_precision precision) {
    open_scene_of(s, precision, "thuman:../assets/demo#person_900006/0/0");
}

static inline void close_scene(scene *s) {
    sherf_avatar_free(s->avatar);
    sherf_observation_free(s->observation);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
}

#endif
