/* SHERF's settings: presets, ranges, and the sizes of weights without metadata. */
#include <stdio.h>
#include <string.h>

#include "model/sherf/sherf.h"

static const sherf_settings paper = {.encoder_width = 64,
                                     .feature_width = 64,
                                     .style_width = 512,
                                     .mapping_layers = 2,
                                     .plane_resolution = 256,
                                     .channel_base = 32768,
                                     .channel_max = 512,
                                     .point_levels = 3,
                                     .volume_channels = {32, 64, 96, 96},
                                     .token_width = 32,
                                     .heads = 3,
                                     .head_width = 16,
                                     .decoder_width = 128,
                                     .decoder_depth = 8,
                                     .decoder_skip = 4,
                                     .view_width = 64,
                                     .position_frequencies = 6,
                                     .direction_frequencies = 4,
                                     .color_frequencies = 5,
                                     .voxel_size_m = 0.005f,
                                     .use_global = 1,
                                     .use_point = 1,
                                     .use_pixel = 1};
enum { PAPER_SAMPLES = 48, PAPER_IMAGE_SIZE = 512 };

const model_preset model_sherf_presets[] = {
    {"paper", ""},
    {"base", "encoder_width=48,style_width=384,channel_base=16384,channel_max=320"},
    {"small", "encoder_width=32,style_width=256,plane_resolution=128,channel_base=8192,channel_max=128,"
              "volume_channels1=48,volume_channels2=64,decoder_width=96,decoder_depth=6,decoder_skip=3,"
              "voxel_size_m=0.01,image_size=256"},
    {0}};

#define AT(field) MODEL_SETTING_AT(sherf_settings, field)
const model_setting model_sherf_setting_list[] = {
    {"encoder_width", AT(encoder_width), 8, 256, 8},
    {"feature_width", AT(feature_width), 32, 256, 32},
    {"style_width", AT(style_width), 16, 2048, 16},
    {"mapping_layers", AT(mapping_layers), 1, GLOBAL_LAYERS, 1},
    {"plane_resolution", AT(plane_resolution), 8, 4 << (GLOBAL_BLOCKS - 1), 8},
    {"channel_base", AT(channel_base), 256, 1 << 20, 1},
    {"channel_max", AT(channel_max), 8, 2048, 1},
    {"point_levels", AT(point_levels), 1, POINT_LEVELS_MAX, 1},
    {"volume_channels0", AT(volume_channels[0]), 8, 256, 1},
    {"volume_channels1", AT(volume_channels[1]), 8, 256, 1},
    {"volume_channels2", AT(volume_channels[2]), 8, 256, 1},
    {"volume_channels3", AT(volume_channels[3]), 8, 256, 1},
    {"token_width", AT(token_width), 32, 32, 32},
    {"heads", AT(heads), 1, 16, 1},
    {"head_width", AT(head_width), 1, 128, 1},
    {"decoder_width", AT(decoder_width), 8, 1024, 8},
    {"decoder_depth", AT(decoder_depth), 2, POINT_DECODER_MAX, 1},
    {"decoder_skip", AT(decoder_skip), 0, POINT_DECODER_MAX - 2, 1},
    {"view_width", AT(view_width), 8, 1024, 8},
    {"position_frequencies", AT(position_frequencies), 1, 16, 1},
    {"direction_frequencies", AT(direction_frequencies), 1, 16, 1},
    {"color_frequencies", AT(color_frequencies), 1, 16, 1},
    {"voxel_size_m", AT(voxel_size_m), 0.002, 0.1, 0},
    {"use_global", AT(use_global), 0, 1, 1},
    {"use_point", AT(use_point), 0, 1, 1},
    {"use_pixel", AT(use_pixel), 0, 1, 1},
    {"fusion", AT(fusion), FUSION_TRANSFORMER, FUSIONS - 1, 1},
    {0}};

_Static_assert(sizeof(sherf_settings) <= MODEL_SETTINGS_ROOM, "settings of a model have this much room");

const sherf_settings *model_sherf_settings(const model_config *config) {
    return (const sherf_settings *)config->own.bytes;
}

static sherf_settings *settings_of(model_config *config) {
    return (sherf_settings *)config->own.bytes;
}

void model_sherf_defaults(model_config *out) {
    *settings_of(out) = paper;
    out->samples = PAPER_SAMPLES;
    out->image_size = PAPER_IMAGE_SIZE;
}

sherf_status model_sherf_check(context *c, const model_config *config) {
    const sherf_settings *k = model_sherf_settings(config);
    const int r = k->plane_resolution;
    if (r & (r - 1))
        return failure(c, SHERF_BAD_ARGUMENT, "model setting plane_resolution=%d: must be a power of 2", r);
    if (k->feature_width + 32 != 3 * k->token_width)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting feature_width=%d: must be 3 token widths less 32", k->feature_width);
    if (3 + 6 * k->color_frequencies < 3 * k->token_width - k->feature_width)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting color_frequencies=%d: too few for %d values of a colour",
                       k->color_frequencies, 3 * k->token_width - k->feature_width);
    if (!k->use_global && !k->use_point && !k->use_pixel)
        return failure(
            c, SHERF_BAD_ARGUMENT,
            "model setting use_global=0: with use_point and use_pixel off there is no feature left");
    if (k->fusion >= FUSION_ADAIN && !(k->use_global && k->use_point && k->use_pixel))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting fusion=%d: takes the global feature as style of the other two: all "
                       "three must be on",
                       k->fusion);
    if (k->decoder_skip > k->decoder_depth - 2)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting decoder_skip=%d: must be below decoder_depth - 1", k->decoder_skip);
    return SHERF_OK;
}

static const safetensor *tensor_of(const safetensors *s, const char *format, int i) {
    char name[128];
    snprintf(name, sizeof name, format, i);
    return safetensors_find(s, name);
}

static int dimension(const safetensors *s, const char *name, int axis) {
    const safetensor *t = safetensors_find(s, name);
    return t && t->rank > axis && t->dim[axis] < 1 << 20 ? (int)t->dim[axis] : 0;
}

/* Derives the sizes of a checkpoint without our metadata. */
sherf_status model_sherf_infer(context *c, const safetensors *s, model_config *out) {
    sherf_status status = model_config_parse_as(c, out->kind, "paper", out);
    if (status != SHERF_OK) return status;
    sherf_settings *k = settings_of(out);
    k->encoder_width = dimension(s, "encoder_2d.backbone.conv1.weight", 0);
    k->feature_width = dimension(s, "encoder_2d_feature.backbone.conv1.weight", 0);
    k->style_width = dimension(s, "backbone.mapping.fc0.weight", 0);
    for (k->mapping_layers = 0; tensor_of(s, "backbone.mapping.fc%d.weight", k->mapping_layers);)
        k->mapping_layers++;
    int r = 4, channels = dimension(s, "backbone.synthesis.b4.conv1.weight", 0);
    k->channel_max = channels;
    while (r < 1 << 16 && tensor_of(s, "backbone.synthesis.b%d.conv1.weight", 2 * r)) r *= 2;
    const safetensor *last = tensor_of(s, "backbone.synthesis.b%d.conv1.weight", r);
    k->plane_resolution = r;
    k->channel_base = last && last->rank > 0 && last->dim[0] < 1 << 20 ? (int)last->dim[0] * r : 0;
    for (int l = 0; l < POINT_LEVELS_MAX; l++) {
        const safetensor *w = tensor_of(s, "renderer.encoder_3d.conv%d.0.weight", l + 1);
        if (!w) break;
        k->volume_channels[l] = w->rank > 0 && w->dim[0] < 1 << 20 ? (int)w->dim[0] : 0;
        k->point_levels = l + 1;
    }
    k->token_width = dimension(s, "renderer.conv1d_reprojection.weight", 0);
    k->head_width = dimension(s, "renderer.transformer.layers.0.0.fn.fn.to_qkv.weight", 0) / 3 / k->heads;
    k->decoder_width = dimension(s, "decoder.pts_linears.0.weight", 0);
    k->view_width = dimension(s, "decoder.views_linear.weight", 0);
    for (k->decoder_depth = 0; tensor_of(s, "decoder.pts_linears.%d.weight", k->decoder_depth);) {
        const safetensor *w = tensor_of(s, "decoder.pts_linears.%d.weight", k->decoder_depth);
        if (k->decoder_depth && w->rank == 2 && w->dim[1] != k->decoder_width)
            k->decoder_skip = k->decoder_depth - 1;
        k->decoder_depth++;
    }
    out->image_size = 0;
    return model_config_check(c, out);
}

bool model_sherf_is_fused(const model_config *config) {
    const sherf_settings *k = model_sherf_settings(config);
    return k->point_levels == POINT_LEVELS && k->use_global && k->use_point && k->use_pixel &&
           k->fusion == FUSION_TRANSFORMER;
}

void model_sherf_sizes(const model_config *config, radiance_sizes *out) {
    const sherf_settings *k = model_sherf_settings(config);
    *out = (radiance_sizes){.token_width = k->token_width,
                            .feature_channels = k->feature_width,
                            .heads = k->heads,
                            .head_width = k->head_width,
                            .decoder_width = k->decoder_width,
                            .decoder_depth = k->decoder_depth,
                            .decoder_skip = k->decoder_skip,
                            .view_width = k->view_width,
                            .position_frequencies = k->position_frequencies,
                            .direction_frequencies = k->direction_frequencies,
                            .color_frequencies = k->color_frequencies};
    memcpy(out->volume_channels, k->volume_channels, sizeof out->volume_channels);
}

double model_sherf_point_products(const model_config *config) {
    const sherf_settings *k = model_sherf_settings(config);
    const double D = k->token_width, W = k->decoder_width, inner = k->heads * k->head_width;
    const double input = 3 + 6 * k->position_frequencies + D, view = W + 3 + 6 * k->direction_frequencies + D;
    const double fusion = D * D + 3 * (D * 3 * inner + inner * D + 2 * D * D);
    const double skip = k->decoder_skip >= 0 && k->decoder_skip < k->decoder_depth - 1 ? input * W : 0;
    const double decoder = input * W + (k->decoder_depth - 1) * W * W + skip + W;
    return fusion + decoder + (view + 3) * k->view_width;
}
