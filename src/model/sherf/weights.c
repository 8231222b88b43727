/* The weights that the fused network reads, by their names in files. */
#include <stdio.h>

#include "model/sherf/sherf.h"

static const float *values_of(const parameters *p, const char *name, const char *suffix) {
    char full[160];
    snprintf(full, sizeof full, "%s%s", name, suffix);
    parameter *q = parameter_find(p, full);
    return q ? q->value.data : NULL;
}

void model_sherf_weights(const parameters *p, const model_config *config, radiance_weights *w) {
    const char *layer0 = "renderer.transformer.layers.0.0.fn.",
               *layer1 = "renderer.transformer.layers.0.1.fn.";
    char name[128];
    *w = (radiance_weights){0};
    w->volume_projection_w = values_of(p, "renderer.conv1d_projection", ".weight");
    w->volume_projection_b = values_of(p, "renderer.conv1d_projection", ".bias");
    w->token_projection_w = values_of(p, "renderer.conv1d_reprojection", ".weight");
    w->token_projection_b = values_of(p, "renderer.conv1d_reprojection", ".bias");
    w->norm0_w = values_of(p, layer0, "norm.weight");
    w->norm0_b = values_of(p, layer0, "norm.bias");
    w->qkv_w = values_of(p, layer0, "fn.to_qkv.weight");
    w->attention_out_w = values_of(p, layer0, "fn.to_out.0.weight");
    w->attention_out_b = values_of(p, layer0, "fn.to_out.0.bias");
    w->norm1_w = values_of(p, layer1, "norm.weight");
    w->norm1_b = values_of(p, layer1, "norm.bias");
    w->mlp0_w = values_of(p, layer1, "fn.net.0.weight");
    w->mlp0_b = values_of(p, layer1, "fn.net.0.bias");
    w->mlp1_w = values_of(p, layer1, "fn.net.3.weight");
    w->mlp1_b = values_of(p, layer1, "fn.net.3.bias");
    for (int i = 0; i < model_sherf_settings(config)->decoder_depth; i++) {
        snprintf(name, sizeof name, "decoder.pts_linears.%d", i);
        w->pts_w[i] = values_of(p, name, ".weight");
        w->pts_b[i] = values_of(p, name, ".bias");
    }
    w->alpha_w = values_of(p, "decoder.alpha_linear", ".weight");
    w->alpha_b = values_of(p, "decoder.alpha_linear", ".bias");
    w->feature_w = values_of(p, "decoder.feature_linear", ".weight");
    w->feature_b = values_of(p, "decoder.feature_linear", ".bias");
    w->views_w = values_of(p, "decoder.views_linear", ".weight");
    w->views_b = values_of(p, "decoder.views_linear", ".bias");
    w->rgb_w = values_of(p, "decoder.rgb_linear", ".weight");
    w->rgb_b = values_of(p, "decoder.rgb_linear", ".bias");
}
