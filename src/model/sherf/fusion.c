/* The feature fusion transformer (section 3.4; network.md 4): each point has three tokens, and one pre-norm
 * layer of self-attention runs over them. Also the alternatives that the paper compares it with
 * (docs/experiments.md). */
#include <math.h>

#include "model/sherf/sherf.h"

static void transformer_declare(declaration *d, const sherf_settings *k, fusion_stage *s) {
    const int64_t D = k->token_width, inner = (int64_t)k->heads * k->head_width;
    s->norm[0] = layer_norm_declare(d, "renderer.transformer.layers.0.0.fn.norm", D);
    s->norm[1] = layer_norm_declare(d, "renderer.transformer.layers.0.1.fn.norm", D);
    s->qkv = declare_weights(d, false, DIMS(3 * inner, D), "renderer.transformer.layers.0.0.fn.fn.to_qkv");
    s->out = linear_declare(d, "renderer.transformer.layers.0.0.fn.fn.to_out.0", false, D, inner);
    s->mlp[0] = linear_declare(d, "renderer.transformer.layers.0.1.fn.fn.net.0", false, D, D);
    s->mlp[1] = linear_declare(d, "renderer.transformer.layers.0.1.fn.fn.net.3", false, D, D);
}

/* A linear layer with these initial weights (their deviation) and biases. */
static linear_layer declare_from(declaration *d, const char *name, int64_t out, int64_t in, double deviation,
                                 float bias) {
    tensor *w = declare(d, (first_values){.deviation = deviation}, DIMS(out, in), "%s.weight", name);
    return (linear_layer){w, declare(d, (first_values){.constant = bias}, DIMS(out), "%s.bias", name)};
}

static void adain_declare(declaration *d, int64_t D, fusion_stage *s) {
    const double small = 0.25 / sqrt((double)D);
    s->content = linear_declare(d, "renderer.adain.content", false, D, 2 * D);
    s->style[0] = declare_from(d, "renderer.adain.scale", D, D, small, 1);
    s->style[1] = declare_from(d, "renderer.adain.shift", D, D, small, 0);
}

/* The mapping starts with pi-GAN's values, the sine layers with SIREN's: their deviations are those of
 * uniform numbers within +/- 1 / n and within +/- sqrt(6 / n) / 25. SIREN's suit frequencies of about 30;
 * FiLM's layers start as linear layers do. */
static void siren_declare(declaration *d, int64_t D, fusion_stage *s) {
    const double mapping = sqrt(2 / (1.04 * (double)D)), n = (double)D;
    const bool film = s->kind == FUSION_FILM;
    s->style[0] = declare_from(d, "renderer.siren.style.0", D, D, mapping, 0);
    s->style[1] = declare_from(d, "renderer.siren.style.1", 4 * D, D, 0.25 * mapping, 0);
    s->sine[0] =
        declare_from(d, "renderer.siren.sine.0", D, 2 * D, film ? 1 / sqrt(2 * n) : 1 / (2 * n) / sqrt(3), 0);
    s->sine[1] =
        declare_from(d, "renderer.siren.sine.1", D, D, film ? 1 / sqrt(n) : sqrt(6 / n) / 25 / sqrt(3), 0);
}

void fusion_declare(declaration *d, const sherf_settings *k, fusion_stage *s) {
    const int64_t D = k->token_width;
    int64_t volume = 0;
    for (int i = 0; i < k->point_levels; i++) volume += k->volume_channels[i];
    s->token_width = k->token_width;
    s->heads = k->heads;
    s->head_width = k->head_width;
    s->kind = (fusion_kind)k->fusion;
    s->parts = k->use_global + k->use_point + k->use_pixel;
    if (k->use_point)
        s->point_projection = linear_declare(d, "renderer.conv1d_projection", false, 3 * D, volume);
    if (s->parts > 1 && s->kind < FUSION_ADAIN)
        s->token_projection = linear_declare(d, "renderer.conv1d_reprojection", false, D, s->parts * D);
    if (s->kind == FUSION_TRANSFORMER) transformer_declare(d, k, s);
    if (s->kind == FUSION_ADAIN) adain_declare(d, D, s);
    if (s->kind > FUSION_ADAIN) siren_declare(d, D, s);
    if (s->kind >= FUSION_FAIR) s->fair = linear_declare(d, "renderer.fair", false, 2 * D, 3 * D);
}

/* [3 P, D] after the transformer: x += out(attention(norm x)), x += mlp(norm x). */
static tensor *transformer(tape *t, const fusion_stage *s, tensor *x) {
    tensor *y = layer_norm_forward(t, &s->norm[0], x);
    y = op_linear(t, y, s->qkv, NULL, 1, 1);
    y = op_token_attention(t, y, POINT_TOKENS, s->heads, s->head_width);
    x = op_add(t, x, linear_forward(t, &s->out, y));
    y = layer_norm_forward(t, &s->norm[1], x);
    y = op_gelu(t, linear_forward(t, &s->mlp[0], y));
    return op_add(t, x, linear_forward(t, &s->mlp[1], y));
}

/* Normalises rows to mean 0 and variance 1. */
static tensor *normalised(tape *t, tensor *x) {
    const int64_t C = x ? tensor_columns(x) : 0;
    float *one = tape_alloc(t, (size_t)C + 1, sizeof *one);
    if (!x || !one) return NULL;
    for (int64_t i = 0; i < C; i++) one[i] = 1;
    return op_layer_norm(t, x, tape_input(t, one, 1, &C), tape_zeros(t, T_F32, 1, &C));
}

/* Adaptive instance norm over a token's channels: scale * norm(content) + shift. style, content [3 P, D],
 * [3 P, 2 D]. */
static tensor *adain(tape *t, const fusion_stage *s, tensor *style, tensor *content) {
    tensor *x = normalised(t, linear_forward(t, &s->content, content));
    return op_add(t, op_multiply(t, linear_forward(t, &s->style[0], style), x),
                  linear_forward(t, &s->style[1], style));
}

/* sin((gain f + base) x + phase); columns `at` and on of the mapping have f, and then the phase. */
static tensor *sine_layer(tape *t, const fusion_stage *s, tensor *mapped, int64_t at, tensor *x) {
    const bool film = s->kind == FUSION_FILM;
    const int64_t D = s->token_width;
    tensor *f = op_slice(t, mapped, at, D), *phase = op_slice(t, mapped, at + D, D);
    tensor *y = op_add(t, op_scale(t, op_multiply(t, f, x), film ? 1 : 15), op_scale(t, x, film ? 1 : 30));
    return op_sine(t, op_add(t, y, phase));
}

/* pi-GAN's FiLM layers; the content is normalised, since frequencies suit values of about 1. */
static tensor *siren(tape *t, const fusion_stage *s, tensor *style, tensor *content) {
    tensor *mapping = op_bias_act(t, linear_forward(t, &s->style[0], style), NULL, 0.2f, 1, 0);
    mapping = linear_forward(t, &s->style[1], mapping);
    tensor *x = linear_forward(t, &s->sine[0], normalised(t, content));
    x = linear_forward(t, &s->sine[1], sine_layer(t, s, mapping, 0, x));
    return sine_layer(t, s, mapping, 2 * (int64_t)s->token_width, x);
}

/* [3 P, C] of the tokens' C columns each. */
static tensor *below_each_other(tape *t, tensor *const token[POINT_TOKENS]) {
    tensor *x = op_concat(t, POINT_TOKENS, token);
    if (!x) return NULL;
    return tape_reshape(t, x, 2,
                        (int64_t[]){tensor_rows(x) * POINT_TOKENS, tensor_columns(x) / POINT_TOKENS});
}

/* Token i: the enabled features, side by side. */
static tensor *token_of(tape *t, const fusion_stage *s, int i, tensor *plane, tensor *pixel, tensor *point) {
    const int64_t D = s->token_width;
    tensor *part[POINT_TOKENS];
    int n = 0;
    if (plane) part[n++] = plane;
    if (pixel) part[n++] = op_slice(t, pixel, i * D, D);
    if (point) part[n++] = op_slice(t, point, i * D, D);
    return n > 1 ? op_concat(t, n, part) : n ? part[0] : NULL;
}

/* [3 P, D]: the projected tokens, or with the transformer's change. */
static tensor *projected(tape *t, const fusion_stage *s, tensor *const plane[3], tensor *pixel,
                         tensor *point) {
    tensor *token[POINT_TOKENS];
    for (int i = 0; i < POINT_TOKENS; i++) token[i] = token_of(t, s, i, plane[i], pixel, point);
    tensor *x = below_each_other(t, token);
    if (s->parts > 1) x = linear_forward(t, &s->token_projection, x);
    return s->kind == FUSION_TRANSFORMER ? transformer(t, s, x) : x;
}

/* [3 P, D]: tokens of pixel and point in the style of the planes'. */
static tensor *styled(tape *t, const fusion_stage *s, tensor *const plane[3], tensor *pixel, tensor *point) {
    tensor *token[POINT_TOKENS];
    for (int i = 0; i < POINT_TOKENS; i++) token[i] = token_of(t, s, i, NULL, pixel, point);
    tensor *style = below_each_other(t, plane), *content = below_each_other(t, token);
    return s->kind == FUSION_ADAIN ? adain(t, s, style, content) : siren(t, s, style, content);
}

tensor *fusion_forward(tape *t, const fusion_stage *s, tensor *const plane[3], tensor *pixel,
                       tensor *volume) {
    tensor *point = volume ? linear_forward(t, &s->point_projection, volume) : NULL;
    tensor *x =
        s->kind >= FUSION_ADAIN ? styled(t, s, plane, pixel, point) : projected(t, s, plane, pixel, point);
    if (!x) return NULL;
    const int64_t D = s->token_width, P = tensor_rows(x) / POINT_TOKENS;
    x = tape_reshape(t, x, 2, (int64_t[]){P, POINT_TOKENS * D});
    return s->kind >= FUSION_FAIR ? linear_forward(t, &s->fair, x) : x;
}
