/* ResNet-18 and ResNet-34 on a tape: stem and basic blocks. */
#include "nn/resnet.h"

#include <stdio.h>
#include <string.h>

static const float eps = 1e-5f, momentum = 0.1f;

static void block_declare(declaration *d, const char *name, int64_t out, int64_t in, int stride,
                          resnet_block *b) {
    char full[LAYER_NAME + 16];
    b->stride = stride;
    for (int i = 0; i < 2; i++) {
        snprintf(full, sizeof full, "%s.conv%d", name, i + 1);
        b->conv[i] = declare_weights(d, true, DIMS(out, i ? out : in, 3, 3), full);
        snprintf(full, sizeof full, "%s.bn%d", name, i + 1);
        b->norm[i] = batch_norm_declare(d, full, true, out, eps, momentum);
    }
    if (in == out) return;
    snprintf(full, sizeof full, "%s.downsample.0", name);
    b->shortcut = declare_weights(d, true, DIMS(out, in, 1, 1), full);
    snprintf(full, sizeof full, "%s.downsample.1", name);
    b->shortcut_norm = batch_norm_declare(d, full, true, out, eps, momentum);
}

void resnet_declare(declaration *d, const char *prefix, int depth, int64_t width, int stages, resnet *out) {
    static const int blocks[2][RESNET_STAGES] = {{2, 2, 2, 2}, {3, 4, 6, 3}};
    char name[LAYER_NAME];
    *out = (resnet){.stages = stages};
    memcpy(out->blocks, blocks[depth == 34], sizeof out->blocks);
    snprintf(name, sizeof name, "%s.conv1", prefix);
    out->stem = declare_weights(d, true, DIMS(width, 3, 7, 7), name);
    snprintf(name, sizeof name, "%s.bn1", prefix);
    out->stem_norm = batch_norm_declare(d, name, true, width, eps, momentum);
    int64_t in = width;
    for (int stage = 1; stage <= stages; stage++)
        for (int block = 0; block < out->blocks[stage - 1]; block++) {
            const int64_t channels = width << (stage - 1);
            snprintf(name, sizeof name, "%s.layer%d.%d", prefix, stage, block);
            block_declare(d, name, channels, in, stage > 1 && block == 0 ? 2 : 1,
                          &out->block[stage - 1][block]);
            in = channels;
        }
}

/* The norm of x, which replaces x: x is no longer read. */
static tensor *normed(tape *t, const batch_norm *n, tensor *x, bool relu) {
    return tape_instead(t, batch_norm_forward(t, n, x, relu), x);
}

tensor *resnet_stem(tape *t, const resnet *r, tensor *image) {
    return normed(t, &r->stem_norm, op_conv2d(t, image, r->stem, 2, 3, 1), true);
}

/* relu(bn2(conv2(relu(bn1(conv1 x)))) + shortcut x) */
static tensor *block_forward(tape *t, const resnet_block *b, tensor *x) {
    tensor *y = normed(t, &b->norm[0], op_conv2d(t, x, b->conv[0], b->stride, 1, 1), true);
    y = normed(t, &b->norm[1], tape_instead(t, op_conv2d(t, y, b->conv[1], 1, 1, 1), y), false);
    tensor *way = x;
    if (b->shortcut) way = normed(t, &b->shortcut_norm, op_conv2d(t, x, b->shortcut, b->stride, 0, 1), false);
    tensor *sum = tape_instead(t, op_add(t, y, way), y);
    if (b->shortcut) tape_drop(t, way);
    return tape_instead(t, op_relu(t, sum), sum);
}

tensor *resnet_stage(tape *t, const resnet *r, int stage, tensor *x) {
    for (int block = 0; block < r->blocks[stage - 1]; block++) {
        tensor *y = block_forward(t, &r->block[stage - 1][block], x);
        if (block) tape_drop(t, x); /* the first one belongs to the caller */
        x = y;
    }
    return x;
}
