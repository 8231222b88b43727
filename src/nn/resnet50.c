/* ResNet-50 up to stage 3 on a tape: stem, bottleneck blocks, and the distance between two pictures'
 * features. */
#include "nn/resnet50.h"

const resnet50_layer resnet50_layers[RESNET50_CONVOLUTIONS] = {
    {"conv1", 3, 64, 7, 2},
    {"res2a_branch2a", 64, 64, 1, 1},
    {"res2a_branch2b", 64, 64, 3, 1},
    {"res2a_branch2c", 64, 256, 1, 1},
    {"res2a_branch1", 64, 256, 1, 1},
    {"res2b_branch2a", 256, 64, 1, 1},
    {"res2b_branch2b", 64, 64, 3, 1},
    {"res2b_branch2c", 64, 256, 1, 1},
    {"res2c_branch2a", 256, 64, 1, 1},
    {"res2c_branch2b", 64, 64, 3, 1},
    {"res2c_branch2c", 64, 256, 1, 1},
    {"res3a_branch2a", 256, 128, 1, 2},
    {"res3a_branch2b", 128, 128, 3, 1},
    {"res3a_branch2c", 128, 512, 1, 1},
    {"res3a_branch1", 256, 512, 1, 2},
    {"res3b_branch2a", 512, 128, 1, 1},
    {"res3b_branch2b", 128, 128, 3, 1},
    {"res3b_branch2c", 128, 512, 1, 1},
    {"res3c_branch2a", 512, 128, 1, 1},
    {"res3c_branch2b", 128, 128, 3, 1},
    {"res3c_branch2c", 128, 512, 1, 1},
    {"res3d_branch2a", 512, 128, 1, 1},
    {"res3d_branch2b", 128, 128, 3, 1},
    {"res3d_branch2c", 128, 512, 1, 1},
};
static const int blocks[2] = {3, 4}; /* of stages 2 and 3 */

void resnet50_free(resnet50_network *n) {
    if (!n) return;
    for (int i = 0; i < RESNET50_CONVOLUTIONS; i++) {
        tensor_free(n->weight[i]);
        tensor_free(n->bias[i]);
    }
    mem_free(n);
}

sherf_status resnet50_create(context *c, resnet50_network **out) {
    *out = NULL;
    resnet50_network *n = mem_zero(c, 1, sizeof *n);
    if (!n) return SHERF_NO_MEMORY;
    for (int i = 0; i < RESNET50_CONVOLUTIONS; i++) {
        const resnet50_layer *l = &resnet50_layers[i];
        int64_t shape[4] = {l->out, l->in, l->side, l->side};
        if (!(n->weight[i] = tensor_create(c, T_F32, 4, shape))) goto fail;
        if (!(n->bias[i] = tensor_create(c, T_F32, 1, shape))) goto fail;
    }
    *out = n;
    return SHERF_OK;
fail:
    resnet50_free(n);
    return SHERF_NO_MEMORY;
}

sherf_status resnet50_place(context *c, resnet50_network *n, const tensor_memory *memory) {
    sherf_status status = SHERF_OK;
    for (int i = 0; n && i < RESNET50_CONVOLUTIONS && status == SHERF_OK; i++) {
        status = tensor_place(c, n->weight[i], memory);
        if (status == SHERF_OK) status = tensor_place(c, n->bias[i], memory);
    }
    return status;
}

static tensor *convolution(tape *t, const resnet50_network *n, tensor *x, int layer) {
    const resnet50_layer *l = &resnet50_layers[layer];
    return op_conv2d(t, x, n->weight[layer], l->stride, l->side / 2, 1);
}

static tensor *relu(tape *t, const resnet50_network *n, tensor *x, int layer) {
    return op_bias_act(t, x, n->bias[layer], 0, 1, 0);
}

/* relu(2c(relu(2b(relu(2a x)))) + shortcut x), from layer *at on. */
static tensor *bottleneck(tape *t, const resnet50_network *n, tensor *x, bool first, int *at) {
    int layer = *at;
    tensor *y = relu(t, n, convolution(t, n, x, layer), layer);
    y = relu(t, n, convolution(t, n, y, layer + 1), layer + 1);
    y = convolution(t, n, y, layer + 2);
    if (first) x = op_bias_act(t, convolution(t, n, x, layer + 3), n->bias[layer + 3], 1, 1, 0);
    *at = layer + (first ? 4 : 3);
    return relu(t, n, op_add(t, y, x), layer + 2);
}

/* The input is 0 to 255 minus ImageNet's mean. */
static void resnet50_features(tape *t, const resnet50_network *n, tensor *picture,
                              tensor *feature[RESNET50_FEATURES]) {
    static const shift_scale_attr scaling = {.shift = {123.68f / 255, 116.779f / 255, 103.939f / 255},
                                             .scale = {1.f / 255, 1.f / 255, 1.f / 255}};
    tensor *x = relu(t, n, convolution(t, n, op_shift_scale(t, picture, &scaling), 0), 0);
    int at = 1;
    feature[0] = x;
    x = op_max_pool(t, x, 3, 2, 1); /* the zero padding in the original is never larger than the values */
    for (int stage = 0; stage < 2; stage++) {
        for (int block = 0; block < blocks[stage]; block++) x = bottleneck(t, n, x, block == 0, &at);
        feature[stage + 1] = x;
    }
}

tensor *resnet50_distance(tape *t, const resnet50_network *n, tensor *a, tensor *b) {
    tensor *of_a[RESNET50_FEATURES], *of_b[RESNET50_FEATURES], *sum = NULL;
    resnet50_features(t, n, a, of_a);
    resnet50_features(t, n, b, of_b);
    for (int i = 0; i < RESNET50_FEATURES; i++) {
        tensor *d = op_feature_distance(t, of_a[i], of_b[i], NULL);
        sum = sum ? op_add(t, sum, d) : d;
    }
    return sum;
}
