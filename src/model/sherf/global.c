/* Hierarchical features, the global one (section 3.3; network.md 1 and 2): a ResNet-18 sees the whole
 * picture. Its latent is the style of a StyleGAN2 generator, which makes three planes of canonical space. */
#include <math.h>
#include <stdio.h>

#include "model/sherf/sherf.h"

static const float leak = 0.2f, root_two = 1.41421356237309515f, clamp_at = 256, mapping_rate = 0.01f;

static int channels_at(const sherf_settings *k, int resolution) {
    const int n = k->channel_base / resolution;
    return n < 1 ? 1 : n < k->channel_max ? n : k->channel_max;
}

/* One modulated layer of the generator with its style affine. */
static modulated_layer modulated_declare(declaration *d, int resolution, const char *layer, int64_t out,
                                         int64_t in, int64_t size, int64_t style) {
    static const first_values normal = {.deviation = 1}, one = {.constant = 1}, zero = {0};
    char name[LAYER_NAME];
    modulated_layer l;
    snprintf(name, sizeof name, "backbone.synthesis.b%d.%s", resolution, layer);
    l.w = declare(d, normal, DIMS(out, in, size, size), "%s.weight", name);
    l.b = declare(d, zero, DIMS(out), "%s.bias", name);
    l.affine.w = declare(d, normal, DIMS(in, style), "%s.affine.weight", name);
    l.affine.b = declare(d, one, DIMS(in), "%s.affine.bias", name);
    return l;
}

void global_declare(declaration *d, const sherf_settings *k, global_stage *s) {
    /* the learning rate multiplier mapping_rate cancels it */
    const first_values mapping = {.deviation = 1 / 0.01};
    const int64_t latent = 8 * (int64_t)k->encoder_width, style = k->style_width;
    s->style_width = (float)k->style_width;
    s->mapping_layers = k->mapping_layers;
    resnet_declare(d, "encoder_2d.backbone", 18, k->encoder_width, 4, &s->encoder);
    for (int i = 0; i < k->mapping_layers; i++) {
        s->mapping[i].w =
            declare(d, mapping, DIMS(style, i ? style : latent), "backbone.mapping.fc%d.weight", i);
        s->mapping[i].b = declare(d, (first_values){0}, DIMS(style), "backbone.mapping.fc%d.bias", i);
    }
    int64_t in = channels_at(k, 4);
    s->constant = declare(d, (first_values){.deviation = 1}, DIMS(4, 4, in), "backbone.synthesis.b4.const");
    if (s->constant) d->p->item[d->p->count - 1]->channels_last = true;
    for (int r = 4; r <= k->plane_resolution; r *= 2) {
        const int64_t out = channels_at(k, r);
        const int i = s->blocks++;
        if (i) s->block[i].conv0 = modulated_declare(d, r, "conv0", out, in, 3, style);
        s->block[i].conv1 = modulated_declare(d, r, "conv1", out, out, 3, style);
        s->block[i].planes = modulated_declare(d, r, "torgb", 3 * k->token_width, out, 1, style);
        in = out;
    }
}

tensor *global_latent(tape *t, const global_stage *s, tensor *image) {
    tensor *x = resnet_stem(t, &s->encoder, image);
    x = tape_instead(t, op_max_pool(t, x, 3, 2, 1), x);
    for (int stage = 1; stage <= s->encoder.stages; stage++)
        x = tape_instead(t, resnet_stage(t, &s->encoder, stage, x), x);
    return op_average_pool(t, x);
}

tensor *global_style(tape *t, const global_stage *s, tensor *latent) {
    tensor *x = op_normalize_moment(t, latent);
    for (int i = 0; x && i < s->mapping_layers; i++) {
        const float gain = mapping_rate / sqrtf((float)tensor_columns(x));
        x = linear_forward_scaled(t, &s->mapping[i], x, gain, mapping_rate);
        x = op_bias_act(t, x, NULL, leak, root_two, 0);
    }
    return x;
}

static tensor *affine(tape *t, const global_stage *s, const modulated_layer *l, tensor *style) {
    return linear_forward_scaled(t, &l->affine, style, 1 / sqrtf(s->style_width), 1);
}

/* Modulated 3x3 convolution: scaling the input by the style and the output by the demodulation equals scaling
 * the weights by both. */
static tensor *modulated(tape *t, const global_stage *g, const modulated_layer *l, tensor *x, tensor *style,
                         bool up) {
    tensor *s = affine(t, g, l, style);
    x = op_scale_channels(t, x, s);
    x = tape_instead(t, up ? op_conv2d_transpose(t, x, l->w) : op_conv2d(t, x, l->w, 1, 1, 1), x);
    if (up) x = tape_instead(t, op_fir_upsample(t, x, 1, 1, 1, 4), x);
    x = tape_instead(t, op_scale_channels(t, x, op_demodulation(t, l->w, s)), x);
    return tape_instead(t, op_bias_act(t, x, l->b, leak, root_two, clamp_at), x);
}

static tensor *to_planes(tape *t, const global_stage *g, const modulated_layer *l, tensor *x, tensor *style) {
    if (!x) return NULL;
    tensor *s = op_scale(t, affine(t, g, l, style), 1 / sqrtf((float)tensor_columns(x)));
    tensor *w = tape_reshape(t, l->w, 2, (int64_t[]){l->w->dim[0], l->w->dim[1]});
    tensor *scaled = op_scale_channels(t, x, s);
    tensor *y = tape_instead(t, op_linear(t, scaled, w, NULL, 1, 1), scaled);
    return tape_instead(t, op_bias_act(t, y, l->b, 1, 1, clamp_at), y);
}

tensor *global_planes(tape *t, const global_stage *s, tensor *style, model_stages *stages) {
    tensor *x = s->constant, *image = NULL;
    for (int i = 0; i < s->blocks; i++) {
        tensor *before = x, *below = image;
        if (i) x = modulated(t, s, &s->block[i].conv0, x, style, true);
        if (i && !stages) tape_drop(t, before);
        before = x;
        x = modulated(t, s, &s->block[i].conv1, x, style, false);
        tape_drop(t, before);
        tensor *y = to_planes(t, s, &s->block[i].planes, x, style);
        if (below) {
            tensor *up = op_fir_upsample(t, below, 2, 2, 1, 4);
            if (!stages) tape_drop(t, below);
            image = tape_instead(t, op_add(t, up, y), up);
            tape_drop(t, y);
        } else
            image = y;
        if (stages && stages->blocks < (int)COUNT_OF(stages->block_x)) {
            stages->block_x[stages->blocks] = x;
            stages->block_image[stages->blocks++] = image;
        }
    }
    return image;
}

void global_sample(tape *t, const body_model *body, const model_bank *bank, const float *points_canonical,
                   int64_t count, tensor *out[3]) {
    /* Plane 0 is read at (x, y), plane 1 at (x, z), plane 2 at (z, y), the first running along the width. */
    static const int axis[3][2] = {{0, 1}, {0, 2}, {2, 1}};
    float min[3], max[3];
    body_canonical_bounds_z(body, min, max);
    for (int k = 0; k < 3; k++) {
        tensor *plane = bank->tensor[BANK_PLANE + k];
        out[k] = NULL;
        float *p = plane ? tape_alloc(t, (size_t)count * 2, sizeof *p) : NULL;
        if (!p) continue;
        float R = (float)plane->dim[0];
        for (int64_t i = 0; i < count; i++)
            for (int a = 0; a < 2; a++) {
                int x = axis[k][a];
                float n = (points_canonical[3 * i + x] - min[x]) / (max[x] - min[x]) * 2 - 1;
                p[2 * i + a] = ((n + 1) * R - 1) / 2;
            }
        out[k] = op_sample_bilinear(t, plane, tape_input(t, p, 2, (int64_t[]){count, 2}));
    }
}
