/* Section 1: the two ResNet-18 encoders and what pixel-aligned sampling reads from them. */
#include <stdio.h>

#include "model/sherf/sherf.h"

static const float encoder_eps = 1e-5f, encoder_momentum = 0.1f;

static tensor *norm(tape *t, const model *m, tensor *x, const char *name, bool relu) {
    return layer_batch_norm(t, m, x, name, encoder_eps, encoder_momentum, relu);
}

static tensor *stem(tape *t, const model *m, tensor *image, const char *prefix) {
    char name[96];
    tensor *x = op_conv2d(t, image, model_tensor(m, "%s.backbone.conv1.weight", prefix), 2, 3, 1);
    snprintf(name, sizeof name, "%s.backbone.bn1", prefix);
    return norm(t, m, x, name, true);
}

/* relu(bn2(conv2(relu(bn1(conv1 x)))) + shortcut x) */
static tensor *basic_block(tape *t, const model *m, tensor *x, const char *prefix, int stage, int block) {
    char name[128];
    int n = snprintf(name, sizeof name, "%s.backbone.layer%d.%d", prefix, stage, block);
    char *tail = name + n;
    size_t room = sizeof name - (size_t)n;
    int stride = stage > 1 && block == 0 ? 2 : 1;
    tensor *y = op_conv2d(t, x, model_tensor(m, "%s.conv1.weight", name), stride, 1, 1);
    snprintf(tail, room, ".bn1");
    y = norm(t, m, y, name, true);
    *tail = 0;
    y = op_conv2d(t, y, model_tensor(m, "%s.conv2.weight", name), 1, 1, 1);
    snprintf(tail, room, ".bn2");
    y = norm(t, m, y, name, false);
    *tail = 0;
    if (stride == 2) {
        x = op_conv2d(t, x, model_tensor(m, "%s.downsample.0.weight", name), 2, 0, 1);
        snprintf(tail, room, ".downsample.1");
        x = norm(t, m, x, name, false);
    }
    return op_relu(t, op_add(t, y, x));
}

tensor *encoder_global(tape *t, const model *m, tensor *image) {
    tensor *x = op_max_pool(t, stem(t, m, image, "encoder_2d"), 3, 2, 1);
    for (int stage = 1; stage <= 4; stage++)
        for (int block = 0; block < 2; block++) x = basic_block(t, m, x, "encoder_2d", stage, block);
    return op_average_pool(t, x);
}

tensor *encoder_features(tape *t, const model *m, tensor *image) {
    tensor *x = stem(t, m, image, "encoder_2d_feature");
    for (int block = 0; block < 2; block++) x = basic_block(t, m, x, "encoder_2d_feature", 1, block);
    return x;
}

/* (u / W (W_f - 1), v / H (H_f - 1)) */
static tensor *map_positions(tape *t, const float *position_px, int64_t count, const tensor *image,
                             const tensor *map) {
    float *p = tape_alloc(t, (size_t)count * 2, sizeof *p);
    if (!p) return NULL;
    float W = (float)image->dim[1], H = (float)image->dim[0];
    float right = (float)(map->dim[1] - 1), bottom = (float)(map->dim[0] - 1);
    for (int64_t i = 0; i < count; i++) {
        p[2 * i] = position_px[2 * i] / W * right;
        p[2 * i + 1] = position_px[2 * i + 1] / H * bottom;
    }
    return tape_input(t, p, 2, (int64_t[]){count, 2});
}

tensor *pixel_sample(tape *t, const model *m, const model_bank *bank, const float *position_px,
                     int64_t count) {
    if (!bank->features || !bank->image) return NULL;
    tensor *at = map_positions(t, position_px, count, bank->image, bank->features);
    tensor *feature = op_sample_bilinear(t, bank->features, at);
    tensor *rgb =
        op_sample_bilinear(t, bank->image, map_positions(t, position_px, count, bank->image, bank->image));
    tensor *color = op_positional_encode(t, rgb, 5, 32); /* 33 values, the last one dropped */
    return op_concat(t, 2, (tensor *[]){feature, color});
}
