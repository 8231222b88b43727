#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "model/model.h"

static const model_config paper = {.preset = "paper",
                                   .encoder_width = 64,
                                   .feature_width = 64,
                                   .style_width = 512,
                                   .mapping_layers = 2,
                                   .plane_resolution = 256,
                                   .channel_base = 32768,
                                   .channel_max = 512,
                                   .volume_channels = {32, 64, 96},
                                   .token_width = 32,
                                   .heads = 3,
                                   .head_width = 16,
                                   .decoder_width = 128,
                                   .decoder_depth = 8,
                                   .decoder_skip = 4,
                                   .view_width = 64,
                                   .samples = 48,
                                   .voxel_size_m = 0.005f,
                                   .image_size = 512};

/* The presets, as settings that are not the paper's. */
static const struct {
    const char *name, *settings;
} presets[] = {
    {"paper", ""},
    {"base", "encoder_width=48,style_width=384,channel_base=16384,channel_max=320"},
    {"small", "encoder_width=32,style_width=256,plane_resolution=128,channel_base=8192,channel_max=128,"
              "volume_channels1=48,volume_channels2=64,decoder_width=96,decoder_depth=6,decoder_skip=3,"
              "voxel_size_m=0.01,image_size=256"},
};

/* Every setting: name, where it is, the values that make sense. */
typedef struct {
    const char *name;
    size_t offset;
    int low, high, multiple;
} setting;
#define AT(field) offsetof(model_config, field)
static const setting settings[] = {
    {"encoder_width", AT(encoder_width), 8, 256, 8},
    {"feature_width", AT(feature_width), 32, 256, 32},
    {"style_width", AT(style_width), 16, 2048, 16},
    {"mapping_layers", AT(mapping_layers), 1, 16, 1},
    {"plane_resolution", AT(plane_resolution), 8, 1024, 8},
    {"channel_base", AT(channel_base), 256, 1 << 20, 1},
    {"channel_max", AT(channel_max), 8, 2048, 1},
    {"volume_channels0", AT(volume_channels[0]), 8, 256, 1},
    {"volume_channels1", AT(volume_channels[1]), 8, 256, 1},
    {"volume_channels2", AT(volume_channels[2]), 8, 256, 1},
    {"token_width", AT(token_width), 32, 32, 32},
    {"heads", AT(heads), 1, 16, 1},
    {"head_width", AT(head_width), 1, 128, 1},
    {"decoder_width", AT(decoder_width), 8, 1024, 8},
    {"decoder_depth", AT(decoder_depth), 2, POINT_DECODER_MAX, 1},
    {"decoder_skip", AT(decoder_skip), 0, POINT_DECODER_MAX - 2, 1},
    {"view_width", AT(view_width), 8, 1024, 8},
    {"samples", AT(samples), 2, 1024, 1},
    {"image_size", AT(image_size), 0, 8192, 1},
    {"px_per_m", AT(px_per_m), 0, 100000, 1},
    {"skin_blend_mm", AT(skin_blend_mm), 0, 200, 1},
};

static int *field(model_config *config, const setting *s) {
    return (int *)((char *)config + s->offset);
}

sherf_status model_config_check(context *c, const model_config *config) {
    for (size_t i = 0; i < COUNT_OF(settings); i++) {
        const setting *s = &settings[i];
        int v = *field((model_config *)config, s);
        if (v < s->low || v > s->high || v % s->multiple)
            return failure(c, SHERF_BAD_ARGUMENT, "model setting %s=%d: must be %d to %d in steps of %d",
                           s->name, v, s->low, s->high, s->multiple);
    }
    int r = config->plane_resolution;
    if (r & (r - 1))
        return failure(c, SHERF_BAD_ARGUMENT, "model setting plane_resolution=%d: must be a power of 2", r);
    if (config->feature_width + 32 != 3 * config->token_width)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting feature_width=%d: must be 3 token widths less 32",
                       config->feature_width);
    if (config->decoder_skip > config->decoder_depth - 2)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting decoder_skip=%d: must be below decoder_depth - 1",
                       config->decoder_skip);
    if (!(config->voxel_size_m >= 0.002f && config->voxel_size_m <= 0.1f))
        return failure(c, SHERF_BAD_ARGUMENT, "model setting voxel_size_m=%g: must be 0.002 to 0.1",
                       (double)config->voxel_size_m);
    return SHERF_OK;
}

static sherf_status set_one(context *c, model_config *config, const char *text) {
    const char *equals = strchr(text, '=');
    if (!equals) return failure(c, SHERF_BAD_ARGUMENT, "model setting '%s': should be name=value", text);
    size_t n = (size_t)(equals - text);
    char *end;
    if (n == strlen("voxel_size_m") && !strncmp(text, "voxel_size_m", n)) {
        config->voxel_size_m = strtof(equals + 1, &end);
        if (*end || end == equals + 1)
            return failure(c, SHERF_BAD_ARGUMENT, "model setting '%s': not a number", text);
        return SHERF_OK;
    }
    for (size_t i = 0; i < COUNT_OF(settings); i++) {
        if (strlen(settings[i].name) != n || strncmp(settings[i].name, text, n)) continue;
        long v = strtol(equals + 1, &end, 10);
        if (*end || end == equals + 1 || v < -1000000 || v > 10000000)
            return failure(c, SHERF_BAD_ARGUMENT, "model setting '%s': not a number", text);
        *field(config, &settings[i]) = (int)v;
        return SHERF_OK;
    }
    return failure(c, SHERF_BAD_ARGUMENT, "model setting '%.60s': no such setting", text);
}

/* Settings with commas between; none is fine. */
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

/* *found is false, and nothing else happens, where there is no such preset. */
static sherf_status preset_get(context *c, const char *name, size_t length, model_config *out, bool *found) {
    *found = false;
    for (size_t i = 0; i < COUNT_OF(presets); i++) {
        if (strlen(presets[i].name) != length || strncmp(presets[i].name, name, length)) continue;
        *found = true;
        *out = paper;
        snprintf(out->preset, sizeof out->preset, "%s", presets[i].name);
        return set_all(c, out, presets[i].settings);
    }
    return SHERF_OK;
}

sherf_status model_config_parse(context *c, const char *text, model_config *out) {
    const size_t n = strcspn(text, ",");
    bool found;
    sherf_status status = preset_get(c, text, n, out, &found);
    if (status == SHERF_OK && !found)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model preset '%.*s': should be paper, base or small, or settings behind one",
                       n < 60 ? (int)n : 60, text);
    if (status == SHERF_OK && text[n]) {
        if (!text[n + 1]) return set_one(c, out, "");
        status = set_all(c, out, text + n + 1);
    }
    return status == SHERF_OK ? model_config_check(c, out) : status;
}

char *model_config_text(context *c, const model_config *config) {
    char text[1024];
    model_config from;
    const model_config *base = &from;
    bool found;
    if (preset_get(c, config->preset, strlen(config->preset), &from, &found) != SHERF_OK) return NULL;
    if (!found) base = &paper;
    int n = snprintf(text, sizeof text, "%s", base->preset);
    for (size_t i = 0; i < COUNT_OF(settings); i++) {
        int v = *field((model_config *)config, &settings[i]);
        if (v != *field((model_config *)base, &settings[i]))
            n += snprintf(text + n, sizeof text - (size_t)n, ",%s=%d", settings[i].name, v);
    }
    if (config->voxel_size_m != base->voxel_size_m)
        snprintf(text + n, sizeof text - (size_t)n, ",voxel_size_m=%.9g", (double)config->voxel_size_m);
    return mem_string(c, text);
}

int model_latent_width(const model_config *config) {
    return 8 * config->encoder_width;
}

int model_channels(const model_config *config, int resolution) {
    int n = config->channel_base / resolution;
    return n < 1 ? 1 : n < config->channel_max ? n : config->channel_max;
}

void model_point_sizes(const model_config *config, point_sizes *out) {
    *out = (point_sizes){.token_width = config->token_width,
                         .feature_channels = config->feature_width,
                         .heads = config->heads,
                         .head_width = config->head_width,
                         .decoder_width = config->decoder_width,
                         .decoder_depth = config->decoder_depth,
                         .decoder_skip = config->decoder_skip,
                         .view_width = config->view_width,
                         .position_frequencies = 6,
                         .direction_frequencies = 4,
                         .color_frequencies = 5};
    memcpy(out->volume_channels, config->volume_channels, sizeof out->volume_channels);
}
