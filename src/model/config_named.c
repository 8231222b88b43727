/* Settings of a model that is named beside them: in a text, or in a file's metadata. */
#include <stdio.h>
#include <string.h>

#include "model/model.h"

sherf_status model_config_parse(context *c, const char *text, model_config *out) {
    const size_t n = strcspn(text, ":,");
    const bool named = text[n] == ':';
    const model_kind *kind;
    sherf_status status = model_kind_find(c, named ? text : NULL, n, &kind);
    return status == SHERF_OK ? model_config_parse_as(c, kind, named ? text + n + 1 : text, out) : status;
}

void model_metadata_key(const model_kind *kind, char key[MODEL_KEY]) {
    snprintf(key, MODEL_KEY, "%s.config", kind->name);
}

sherf_status model_config_of_file(context *c, const safetensors *s, const char *key, bool infer,
                                  model_config *out) {
    const char *name = safetensors_metadata(s, "model");
    char own_key[MODEL_KEY];
    const model_kind *kind;
    *out = (model_config){0};
    sherf_status status = model_kind_find(c, name, name ? strlen(name) : 0, &kind);
    if (status != SHERF_OK) return status;
    model_metadata_key(kind, own_key);
    const char *text = safetensors_metadata(s, key ? key : own_key);
    if (text) return model_config_parse_as(c, kind, text, out);
    if (!infer || !kind->infer)
        return failure(c, SHERF_BAD_FILE, "model %s without its settings (%s) in the file", kind->name,
                       key ? key : own_key);
    *out = (model_config){.kind = kind};
    return kind->infer(c, s, out);
}
