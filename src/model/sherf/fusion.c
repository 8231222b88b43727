/* The feature fusion transformer (section 3.4; network.md 4): three tokens of each point, one pre-norm layer
 * over them. */
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
    if (s->parts > 1)
        s->token_projection = linear_declare(d, "renderer.conv1d_reprojection", false, D, s->parts * D);
    if (s->kind == FUSION_TRANSFORMER) transformer_declare(d, k, s);
    if (s->kind == FUSION_FAIR) s->fair = linear_declare(d, "renderer.fair", false, 2 * D, 3 * D);
}

/* [3 P, D]: what the transformer changes, x += out(attention(norm x)), x += mlp(norm x). */
static tensor *transformer(tape *t, const fusion_stage *s, tensor *x) {
    tensor *y = layer_norm_forward(t, &s->norm[0], x);
    y = op_linear(t, y, s->qkv, NULL, 1, 1);
    y = op_token_attention(t, y, POINT_TOKENS, s->heads, s->head_width);
    x = op_add(t, x, linear_forward(t, &s->out, y));
    y = layer_norm_forward(t, &s->norm[1], x);
    y = op_gelu(t, linear_forward(t, &s->mlp[0], y));
    return op_add(t, x, linear_forward(t, &s->mlp[1], y));
}

/* Token i: the features that are on, side by side. */
static tensor *token_of(tape *t, const fusion_stage *s, int i, tensor *plane, tensor *pixel, tensor *point) {
    const int64_t D = s->token_width;
    tensor *part[POINT_TOKENS];
    int n = 0;
    if (plane) part[n++] = plane;
    if (pixel) part[n++] = op_slice(t, pixel, i * D, D);
    if (point) part[n++] = op_slice(t, point, i * D, D);
    return n > 1 ? op_concat(t, n, part) : n ? part[0] : NULL;
}

tensor *fusion_forward(tape *t, const fusion_stage *s, tensor *const plane[3], tensor *pixel,
                       tensor *volume) {
    const int64_t D = s->token_width;
    tensor *point = volume ? linear_forward(t, &s->point_projection, volume) : NULL, *token[POINT_TOKENS];
    for (int i = 0; i < POINT_TOKENS; i++) token[i] = token_of(t, s, i, plane[i], pixel, point);
    tensor *x = op_concat(t, POINT_TOKENS, token);
    if (!x) return NULL;
    const int64_t P = tensor_rows(x);
    x = tape_reshape(t, x, 2, (int64_t[]){P * POINT_TOKENS, s->parts * D});
    if (s->parts > 1) x = linear_forward(t, &s->token_projection, x);
    if (s->kind == FUSION_TRANSFORMER) x = transformer(t, s, x);
    x = tape_reshape(t, x, 2, (int64_t[]){P, POINT_TOKENS * D});
    return s->kind == FUSION_FAIR ? linear_forward(t, &s->fair, x) : x;
}
