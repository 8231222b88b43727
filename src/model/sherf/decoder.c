/* The NeRF decoder (section 3.4; network.md 5): density from position and token 0, colour from feature,
 * direction and token 1. */
#include <stdio.h>

#include "model/sherf/sherf.h"

/* Number of values of a position or direction after positional encoding. */
static int encoded(int frequencies) {
    return 3 + 6 * frequencies;
}

void decoder_declare(declaration *d, const sherf_settings *k, decoder_stage *s) {
    const int64_t W = k->decoder_width, x = encoded(k->position_frequencies) + k->token_width;
    char name[LAYER_NAME];
    s->token_width = k->token_width;
    s->depth = k->decoder_depth;
    s->skip = k->decoder_skip;
    s->position_frequencies = k->position_frequencies;
    s->direction_frequencies = k->direction_frequencies;
    for (int i = 0; i < s->depth; i++) {
        snprintf(name, sizeof name, "decoder.pts_linears.%d", i);
        s->pts[i] = linear_declare(d, name, true, W, i == 0 ? x : i == s->skip + 1 ? W + x : W);
    }
    s->views = linear_declare(d, "decoder.views_linear", true, k->view_width,
                              W + encoded(k->direction_frequencies) + k->token_width);
    s->feature = linear_declare(d, "decoder.feature_linear", false, W, W);
    s->alpha = linear_declare(d, "decoder.alpha_linear", false, 1, W);
    s->rgb = linear_declare(d, "decoder.rgb_linear", false, 3, k->view_width);
}

void decoder_forward(tape *t, const decoder_stage *s, tensor *tokens, const float *points_canonical,
                     const float *directions_canonical, int64_t count, tensor **sigma, tensor **rgb) {
    const int64_t D = s->token_width;
    const int p = s->position_frequencies, v = s->direction_frequencies;
    tensor *position = tape_input(t, points_canonical, 2, (int64_t[]){count, 3});
    tensor *direction = tape_input(t, directions_canonical, 2, (int64_t[]){count, 3});
    tensor *x = op_concat(
        t, 2, (tensor *[]){op_positional_encode(t, position, p, encoded(p)), op_slice(t, tokens, 0, D)});
    tensor *h = x;
    for (int i = 0; i < s->depth; i++) {
        h = op_relu(t, linear_forward(t, &s->pts[i], h));
        if (i == s->skip) h = op_concat(t, 2, (tensor *[]){x, h});
    }
    *sigma = linear_forward(t, &s->alpha, h);
    tensor *feature = linear_forward(t, &s->feature, h);
    tensor *view = op_positional_encode(t, direction, v, encoded(v));
    h = op_concat(t, 3, (tensor *[]){feature, view, op_slice(t, tokens, D, D)});
    h = op_relu(t, linear_forward(t, &s->views, h));
    *rgb = op_sigmoid(t, linear_forward(t, &s->rgb, h), 1.002f, -0.001f);
}
