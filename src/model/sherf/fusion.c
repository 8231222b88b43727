/* The feature fusion transformer (section 3.4; network.md 4): three tokens of each point, one pre-norm layer
 * over them. */
#include "model/sherf/sherf.h"

void fusion_declare(declaration *d, const sherf_settings *k, fusion_stage *s) {
    const int64_t D = k->token_width, inner = (int64_t)k->heads * k->head_width;
    int64_t volume = 0;
    for (int i = 0; i < k->point_levels; i++) volume += k->volume_channels[i];
    s->token_width = k->token_width;
    s->heads = k->heads;
    s->head_width = k->head_width;
    s->point_projection = linear_declare(d, "renderer.conv1d_projection", false, 3 * D, volume);
    s->token_projection = linear_declare(d, "renderer.conv1d_reprojection", false, D, 3 * D);
    s->norm[0] = layer_norm_declare(d, "renderer.transformer.layers.0.0.fn.norm", D);
    s->norm[1] = layer_norm_declare(d, "renderer.transformer.layers.0.1.fn.norm", D);
    s->qkv = declare_weights(d, false, DIMS(3 * inner, D), "renderer.transformer.layers.0.0.fn.fn.to_qkv");
    s->out = linear_declare(d, "renderer.transformer.layers.0.0.fn.fn.to_out.0", false, D, inner);
    s->mlp[0] = linear_declare(d, "renderer.transformer.layers.0.1.fn.fn.net.0", false, D, D);
    s->mlp[1] = linear_declare(d, "renderer.transformer.layers.0.1.fn.fn.net.3", false, D, D);
}

tensor *fusion_forward(tape *t, const fusion_stage *s, tensor *const plane[3], tensor *pixel,
                       tensor *volume) {
    const int64_t D = s->token_width;
    tensor *point = linear_forward(t, &s->point_projection, volume), *token[POINT_TOKENS];
    if (!point) return NULL;
    const int64_t P = tensor_rows(point);
    for (int i = 0; i < POINT_TOKENS; i++)
        token[i] = op_concat(
            t, 3, (tensor *[]){plane[i], op_slice(t, pixel, i * D, D), op_slice(t, point, i * D, D)});
    tensor *x = op_concat(t, POINT_TOKENS, token);
    x = tape_reshape(t, x, 2, (int64_t[]){P * POINT_TOKENS, 3 * D});
    x = linear_forward(t, &s->token_projection, x);
    /* x += out(attention(norm x)) */
    tensor *y = layer_norm_forward(t, &s->norm[0], x);
    y = op_linear(t, y, s->qkv, NULL, 1, 1);
    y = op_token_attention(t, y, POINT_TOKENS, s->heads, s->head_width);
    x = op_add(t, x, linear_forward(t, &s->out, y));
    /* x += mlp(norm x) */
    y = layer_norm_forward(t, &s->norm[1], x);
    y = op_gelu(t, linear_forward(t, &s->mlp[0], y));
    x = op_add(t, x, linear_forward(t, &s->mlp[1], y));
    return tape_reshape(t, x, 2, (int64_t[]){P, POINT_TOKENS * D});
}
