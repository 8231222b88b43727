/* The table of models. A new one is a file with its model_kind, `model_NAME`, and a line here. */
#include <string.h>

#include "model/model.h"

/* Weights that name no model are the first's. */
#define MODELS(MODEL) MODEL(sherf) MODEL(pixelnerf) MODEL(nhp) MODEL(mpsnerf) MODEL(pifu)

#define DECLARE(name) extern const model_kind model_##name;
MODELS(DECLARE)
#define ENTRY(name) &model_##name,
static const model_kind *const table[] = {MODELS(ENTRY)};

static const model_kind *of_tests;

void model_kind_add(const model_kind *kind) {
    of_tests = kind;
}

static bool is_called(const model_kind *k, const char *name, size_t length) {
    return k && strlen(k->name) == length && !strncmp(k->name, name, length);
}

sherf_status model_kind_find(context *c, const char *name, size_t length, const model_kind **out) {
    *out = NULL;
    for (size_t i = 0; i < COUNT_OF(table); i++)
        if (!name || is_called(table[i], name, length)) {
            *out = table[i];
            return SHERF_OK;
        }
    if (is_called(of_tests, name, length)) {
        *out = of_tests;
        return SHERF_OK;
    }
    return failure(c, SHERF_UNSUPPORTED, "model '%.*s': this version of sherf has no such model",
                   length < 60 ? (int)length : 60, name);
}
