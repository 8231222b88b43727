/* Section 5: density from position and token 0, colour from feature, direction and token 1. */
#include <stdio.h>

#include "model/sherf/sherf.h"

void decoder(tape *t, const model *m, tensor *tokens, const float *points_canonical,
             const float *directions_canonical, int64_t count, tensor **sigma, tensor **rgb) {
    const model_config *k = &m->config;
    const int64_t D = k->token_width;
    char name[64];
    tensor *position = tape_input(t, points_canonical, 2, (int64_t[]){count, 3});
    tensor *direction = tape_input(t, directions_canonical, 2, (int64_t[]){count, 3});
    tensor *x =
        op_concat(t, 2, (tensor *[]){op_positional_encode(t, position, 6, 39), op_slice(t, tokens, 0, D)});
    tensor *h = x;
    for (int i = 0; i < k->decoder_depth; i++) {
        snprintf(name, sizeof name, "decoder.pts_linears.%d", i);
        h = op_relu(t, layer_linear(t, m, h, name));
        if (i == k->decoder_skip) h = op_concat(t, 2, (tensor *[]){x, h});
    }
    *sigma = layer_linear(t, m, h, "decoder.alpha_linear");
    tensor *feature = layer_linear(t, m, h, "decoder.feature_linear");
    tensor *view = op_positional_encode(t, direction, 4, 27);
    h = op_concat(t, 3, (tensor *[]){feature, view, op_slice(t, tokens, D, D)});
    h = op_relu(t, layer_linear(t, m, h, "decoder.views_linear"));
    *rgb = op_sigmoid(t, layer_linear(t, m, h, "decoder.rgb_linear"), 1.002f, -0.001f);
}
