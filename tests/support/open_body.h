/* The open body for the functions of a test, whose state is a context. */
#ifndef TEST_OPEN_BODY_H
#define TEST_OPEN_BODY_H

#include "data/data.h"
#include "support.h"

static body_model *body;

static int open_body(void **state) {
    context *c = *state = test_context();
    assert_ok(c, body_load(c, "../assets/body.safetensors", &body));
    return 0;
}

static int close_body(void **state) {
    sherf_body_free(body);
    sherf_context_free(*state);
    return 0;
}

#endif
