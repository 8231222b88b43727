/* Models by the table: parameters, and the public functions. */
#include "model/model.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

sherf_status model_shape(context *c, const model_config *config, model **out) {
    const model_kind *kind = config->kind;
    *out = NULL;
    sherf_status status = model_config_check(c, config);
    if (status != SHERF_OK) return status;
    model *m = mem_zero(c, 1, sizeof *m);
    if (!m) return SHERF_NO_MEMORY;
    m->config = *config;
    m->weights = parameters_create(c);
    m->network = mem_zero(c, 1, kind->network_bytes);
    declaration d = {c, m->weights, !m->weights || !m->network};
    if (!d.failed) kind->declare(&d, config, m->network);
    status = d.failed ? SHERF_NO_MEMORY : parameters_lay_out(c, m->weights);
    if (status != SHERF_OK) {
        model_free(m);
        return status;
    }
    *out = m;
    return SHERF_OK;
}

sherf_status model_create(context *c, const model_config *config, uint64_t seed, model **out) {
    sherf_status status = model_shape(c, config, out);
    if (status == SHERF_OK) parameters_initialise((*out)->weights, seed);
    return status;
}

void model_free(model *m) {
    if (!m) return;
    parameters_free(m->weights);
    mem_free(m->network);
    mem_free(m);
}

sherf_status model_place(context *c, model *m) {
    return parameters_place(c, m->weights, backend_of(c)->memory);
}

const training_recipe *model_recipe(const model_config *config) {
    return config->kind->recipe ? config->kind->recipe(config) : NULL;
}

sherf_status model_needs_canonical(context *c, const model_config *config) {
    if (!config->kind->one_pose) return SHERF_OK;
    return failure(c, SHERF_UNSUPPORTED,
                   "model %s has no canonical space: it shows the observed pose alone, from any camera, and "
                   "cannot be animated or exported",
                   config->kind->name);
}

bool model_has_whole_box(const model_config *config) {
    return config->kind->whole_box && config->kind->whole_box(config);
}

bool model_is_queried(const model_kind *kind, const char *name) {
    const char *const *start = kind->queried;
    if (!start) return true;
    while (*start && strncmp(name, *start, strlen(*start)) != 0) start++;
    return *start != NULL;
}

tensor *model_tensor(const model *m, const char *format, ...) {
    char name[256];
    va_list args;
    va_start(args, format);
    vsnprintf(name, sizeof name, format, args);
    va_end(args);
    parameter *q = parameter_find(m->weights, name);
    return q ? &q->value : NULL;
}

sherf_status sherf_model_create(sherf_context *c, const char *preset, uint64_t seed, sherf_model **out) {
    *out = NULL;
    model_config config;
    sherf_status status = model_config_parse(c, preset, &config);
    if (status == SHERF_OK) status = model_create(c, &config, seed, out);
    if (status == SHERF_OK && (status = model_place(c, *out)) != SHERF_OK) {
        model_free(*out);
        *out = NULL;
    }
    return status;
}

void sherf_model_free(sherf_model *m) {
    model_free(m);
}
int64_t sherf_model_parameter_count(const sherf_model *m) {
    return parameters_trained_count(m->weights);
}
