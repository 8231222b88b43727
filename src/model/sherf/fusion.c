/* Section 4: three tokens of each point, one transformer layer over them. */
#include "model/sherf/sherf.h"

tensor *fusion(tape *t, const model *m, tensor *const plane[3], tensor *pixel, tensor *volume) {
    const model_config *k = &m->config;
    const int64_t D = k->token_width;
    const char *layer0 = "renderer.transformer.layers.0.0.fn.",
               *layer1 = "renderer.transformer.layers.0.1.fn.";
    tensor *point = layer_linear(t, m, volume, "renderer.conv1d_projection"), *token[POINT_TOKENS];
    if (!point) return NULL;
    const int64_t P = tensor_rows(point);
    for (int i = 0; i < POINT_TOKENS; i++)
        token[i] = op_concat(
            t, 3, (tensor *[]){plane[i], op_slice(t, pixel, i * D, D), op_slice(t, point, i * D, D)});
    tensor *x = op_concat(t, POINT_TOKENS, token);
    x = tape_reshape(t, x, 2, (int64_t[]){P * POINT_TOKENS, 3 * D});
    x = layer_linear(t, m, x, "renderer.conv1d_reprojection");
    /* x += out(attention(norm x)) */
    tensor *y =
        op_layer_norm(t, x, model_tensor(m, "%snorm.weight", layer0), model_tensor(m, "%snorm.bias", layer0));
    y = op_linear(t, y, model_tensor(m, "%sfn.to_qkv.weight", layer0), NULL, 1, 1);
    y = op_token_attention(t, y, POINT_TOKENS, k->heads, k->head_width);
    x = op_add(t, x, layer_linear(t, m, y, "renderer.transformer.layers.0.0.fn.fn.to_out.0"));
    /* x += mlp(norm x) */
    y = op_layer_norm(t, x, model_tensor(m, "%snorm.weight", layer1), model_tensor(m, "%snorm.bias", layer1));
    y = op_gelu(t, layer_linear(t, m, y, "renderer.transformer.layers.0.1.fn.fn.net.0"));
    x = op_add(t, x, layer_linear(t, m, y, "renderer.transformer.layers.0.1.fn.fn.net.3"));
    return tape_reshape(t, x, 2, (int64_t[]){P, POINT_TOKENS * D});
}
