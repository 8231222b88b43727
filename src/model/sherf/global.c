/* Section 2: mapping, StyleGAN2 synthesis (skip architecture), the three planes. */
#include <math.h>
#include <stdio.h>

#include "model/sherf/sherf.h"

static const float leak = 0.2f, root_two = 1.41421356237309515f, clamp_at = 256;

tensor *triplane_style(tape *t, const model *m, tensor *latent) {
    tensor *x = op_normalize_moment(t, latent);
    for (int i = 0; x && i < m->config.mapping_layers; i++) {
        char name[64];
        snprintf(name, sizeof name, "backbone.mapping.fc%d", i);
        x = layer_linear_scaled(t, m, x, name, 0.01f / sqrtf((float)tensor_columns(x)), 0.01f);
        x = op_bias_act(t, x, NULL, leak, root_two, 0);
    }
    return x;
}

static tensor *affine(tape *t, const model *m, tensor *style, const char *layer) {
    char name[128];
    snprintf(name, sizeof name, "%s.affine", layer);
    return layer_linear_scaled(t, m, style, name, 1 / sqrtf((float)m->config.style_width), 1);
}

/* Modulated 3x3 convolution: scaling the input by the style and the output by the demodulation equals scaling
 * the weights by both. */
static tensor *modulated(tape *t, const model *m, tensor *x, tensor *style, const char *layer, bool up) {
    tensor *w = model_tensor(m, "%s.weight", layer), *b = model_tensor(m, "%s.bias", layer);
    tensor *s = affine(t, m, style, layer);
    x = op_scale_channels(t, x, s);
    x = up ? op_fir_upsample(t, op_conv2d_transpose(t, x, w), 1, 1, 1, 4) : op_conv2d(t, x, w, 1, 1, 1);
    x = op_scale_channels(t, x, op_demodulation(t, w, s));
    return op_bias_act(t, x, b, leak, root_two, clamp_at);
}

static tensor *to_planes(tape *t, const model *m, tensor *x, tensor *style, const char *layer) {
    tensor *w = model_tensor(m, "%s.weight", layer), *b = model_tensor(m, "%s.bias", layer);
    if (!x || !w) return NULL;
    tensor *s = op_scale(t, affine(t, m, style, layer), 1 / sqrtf((float)tensor_columns(x)));
    w = tape_reshape(t, w, 2, (int64_t[]){w->dim[0], w->dim[1]});
    return op_bias_act(t, op_linear(t, op_scale_channels(t, x, s), w, NULL, 1, 1), b, 1, 1, clamp_at);
}

tensor *triplane_synthesis(tape *t, const model *m, tensor *style, model_stages *stages) {
    tensor *x = model_tensor(m, "backbone.synthesis.b4.const"), *image = NULL;
    char name[64];
    for (int r = 4; r <= m->config.plane_resolution; r *= 2) {
        if (r > 4) {
            snprintf(name, sizeof name, "backbone.synthesis.b%d.conv0", r);
            x = modulated(t, m, x, style, name, true);
        }
        snprintf(name, sizeof name, "backbone.synthesis.b%d.conv1", r);
        x = modulated(t, m, x, style, name, false);
        snprintf(name, sizeof name, "backbone.synthesis.b%d.torgb", r);
        tensor *y = to_planes(t, m, x, style, name);
        image = image ? op_add(t, op_fir_upsample(t, image, 2, 2, 1, 4), y) : y;
        if (stages && stages->blocks < (int)COUNT_OF(stages->block_x)) {
            stages->block_x[stages->blocks] = x;
            stages->block_image[stages->blocks++] = image;
        }
    }
    return image;
}

void triplane_sample(tape *t, const body_model *body, const model_bank *bank, const float *points_canonical,
                     int64_t count, tensor *out[3]) {
    /* Plane 0 is read at (x, y), plane 1 at (x, z), plane 2 at (z, y), the first running along the width. */
    static const int axis[3][2] = {{0, 1}, {0, 2}, {2, 1}};
    float min[3], max[3];
    body_canonical_bounds_z(body, min, max);
    for (int k = 0; k < 3; k++) {
        out[k] = NULL;
        float *p = bank->plane[k] ? tape_alloc(t, (size_t)count * 2, sizeof *p) : NULL;
        if (!p) continue;
        float R = (float)bank->plane[k]->dim[0];
        for (int64_t i = 0; i < count; i++)
            for (int a = 0; a < 2; a++) {
                int x = axis[k][a];
                float n = (points_canonical[3 * i + x] - min[x]) / (max[x] - min[x]) * 2 - 1;
                p[2 * i + a] = ((n + 1) * R - 1) / 2;
            }
        out[k] = op_sample_bilinear(t, bank->plane[k], tape_input(t, p, 2, (int64_t[]){count, 2}));
    }
}
