/* Settings of models as text: a preset and the settings that differ from it. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/model.h"

#define AT(field) offsetof(model_config, field)
/* What every model has. */
static const model_setting common[] = {{"samples", AT(samples), 2, 1024, 1},
                                       {"image_size", AT(image_size), 0, 8192, 1},
                                       {"px_per_m", AT(px_per_m), 0, 100000, 1},
                                       {"skin_blend_mm", AT(skin_blend_mm), 0, 200, 1},
                                       {"occlusion", AT(occlusion), 0, 2, 1}};

/* Setting i: first the model's own, then the common ones; NULL after the last. */
static const model_setting *setting(const model_kind *kind, size_t i) {
    size_t own = 0;
    while (kind->settings[own].name) own++;
    return i < own ? &kind->settings[i] : i - own < COUNT_OF(common) ? &common[i - own] : NULL;
}

static double value_of(const model_config *config, const model_setting *s) {
    const char *at = (const char *)config + s->offset;
    int whole;
    float real;
    memcpy(&whole, at, sizeof whole);
    memcpy(&real, at, sizeof real);
    return s->multiple ? (double)whole : (double)real;
}

static void value_set(model_config *config, const model_setting *s, double v) {
    char *at = (char *)config + s->offset;
    const int whole = s->multiple ? (int)v : 0;
    const float real = (float)v;
    memcpy(at, s->multiple ? (const void *)&whole : (const void *)&real, sizeof whole);
}

sherf_status model_config_check(context *c, const model_config *config) {
    const model_setting *s;
    for (size_t i = 0; (s = setting(config->kind, i)); i++) {
        const double v = value_of(config, s);
        if (!s->multiple && !(v >= (double)(float)s->low && v <= (double)(float)s->high))
            return failure(c, SHERF_BAD_ARGUMENT, "model setting %s=%g: must be %g to %g", s->name, v, s->low,
                           s->high);
        if (s->multiple && (v < s->low || v > s->high || (int)v % s->multiple))
            return failure(c, SHERF_BAD_ARGUMENT,
                           "model setting %s=%.0f: must be %.0f to %.0f in steps of %d", s->name, v, s->low,
                           s->high, s->multiple);
    }
    if (config->occlusion && !config->kind->reads_observed_px)
        return failure(c, SHERF_BAD_ARGUMENT, "model setting occlusion=%d: model %s has no such way, only 0",
                       config->occlusion, config->kind->name);
    return config->kind->check ? config->kind->check(c, config) : SHERF_OK;
}

static sherf_status set_one(context *c, model_config *config, const char *text) {
    const char *equals = strchr(text, '=');
    if (!equals) return failure(c, SHERF_BAD_ARGUMENT, "model setting '%s': should be name=value", text);
    const size_t n = (size_t)(equals - text);
    const model_setting *s;
    for (size_t i = 0; (s = setting(config->kind, i)); i++) {
        if (strlen(s->name) != n || strncmp(s->name, text, n)) continue;
        char *end;
        const double v = s->multiple ? (double)strtol(equals + 1, &end, 10) : strtof(equals + 1, &end);
        if (*end || end == equals + 1 || (s->multiple && (v < -1000000 || v > 10000000)))
            return failure(c, SHERF_BAD_ARGUMENT, "model setting '%s': not a number", text);
        value_set(config, s, v);
        return SHERF_OK;
    }
    return failure(c, SHERF_BAD_ARGUMENT, "model setting '%.60s': no such setting", text);
}

/* Comma-separated settings; there may be none. */
static sherf_status set_all(context *c, model_config *config, const char *text) {
    char copy[1024];
    if (strlen(text) >= sizeof copy) return failure(c, SHERF_BAD_ARGUMENT, "model preset: text too long");
    strcpy(copy, text);
    for (char *rest = *copy ? copy : NULL, *part; (part = strsep(&rest, ","));) {
        sherf_status status = set_one(c, config, part);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* If there is no such preset, sets *found to false and does nothing else. */
static sherf_status preset_get(context *c, const model_kind *kind, const char *name, size_t length,
                               model_config *out, bool *found) {
    *found = false;
    for (const model_preset *p = kind->presets; p->name; p++) {
        if (strlen(p->name) != length || strncmp(p->name, name, length)) continue;
        *found = true;
        *out = (model_config){.kind = kind};
        kind->defaults(out);
        snprintf(out->preset, sizeof out->preset, "%s", p->name);
        return set_all(c, out, p->settings);
    }
    return SHERF_OK;
}

static sherf_status no_such_preset(context *c, const model_kind *kind, const char *text, size_t n) {
    char names[200] = "";
    for (const model_preset *p = kind->presets; p->name; p++) {
        const size_t used = strlen(names);
        snprintf(names + used, sizeof names - used, "%s%s", used ? p[1].name ? ", " : " or " : "", p->name);
    }
    return failure(c, SHERF_BAD_ARGUMENT, "model preset '%.*s': should be %s, or settings behind one",
                   n < 60 ? (int)n : 60, text, names);
}

sherf_status model_config_parse_as(context *c, const model_kind *kind, const char *text, model_config *out) {
    const size_t n = strcspn(text, ",");
    bool found;
    sherf_status status = preset_get(c, kind, text, n, out, &found);
    if (status == SHERF_OK && !found) return no_such_preset(c, kind, text, n);
    if (status == SHERF_OK && text[n]) {
        if (!text[n + 1]) return set_one(c, out, "");
        status = set_all(c, out, text + n + 1);
    }
    return status == SHERF_OK ? model_config_check(c, out) : status;
}

char *model_config_text(context *c, const model_config *config) {
    const model_kind *kind = config->kind;
    const char *first = kind->presets->name;
    char text[1024];
    model_config base;
    bool found;
    if (preset_get(c, kind, config->preset, strlen(config->preset), &base, &found) != SHERF_OK ||
        (!found && preset_get(c, kind, first, strlen(first), &base, &found) != SHERF_OK))
        return NULL;
    size_t n = (size_t)snprintf(text, sizeof text, "%s", base.preset);
    const model_setting *s;
    for (size_t i = 0; n < sizeof text && (s = setting(kind, i)); i++) {
        const double v = value_of(config, s);
        if (v != value_of(&base, s)) n += (size_t)snprintf(text + n, sizeof text - n, ",%s=%.9g", s->name, v);
    }
    if (n < sizeof text) return mem_string(c, text);
    failure(c, SHERF_BAD_ARGUMENT, "model preset: text too long");
    return NULL;
}
