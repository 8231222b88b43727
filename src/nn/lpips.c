/* LPIPS on a tape: VGG16's thirteen convolutions on both pictures, and a distance at the end of each of the
 * five stages. */
#include "nn/lpips.h"

const lpips_layer lpips_layers[LPIPS_CONVOLUTIONS] = {
    {0, 3, 64, 0},     {2, 64, 64, 0},    {5, 64, 128, 1},   {7, 128, 128, 1},  {10, 128, 256, 2},
    {12, 256, 256, 2}, {14, 256, 256, 2}, {17, 256, 512, 3}, {19, 512, 512, 3}, {21, 512, 512, 3},
    {24, 512, 512, 4}, {26, 512, 512, 4}, {28, 512, 512, 4}};
static const int stage_channels[LPIPS_STAGES] = {64, 128, 256, 512, 512};

void lpips_free(lpips_network *n) {
    if (!n) return;
    for (int i = 0; i < LPIPS_CONVOLUTIONS; i++) {
        tensor_free(n->weight[i]);
        tensor_free(n->bias[i]);
    }
    for (int i = 0; i < LPIPS_STAGES; i++) tensor_free(n->head[i]);
    mem_free(n);
}

sherf_status lpips_create(context *c, lpips_network **out) {
    *out = NULL;
    lpips_network *n = mem_zero(c, 1, sizeof *n);
    if (!n) return SHERF_NO_MEMORY;
    for (int i = 0; i < LPIPS_CONVOLUTIONS; i++) {
        int64_t shape[4] = {lpips_layers[i].out, lpips_layers[i].in, 3, 3};
        if (!(n->weight[i] = tensor_create(c, T_F32, 4, shape))) goto fail;
        if (!(n->bias[i] = tensor_create(c, T_F32, 1, shape))) goto fail;
    }
    for (int i = 0; i < LPIPS_STAGES; i++) {
        int64_t shape = stage_channels[i];
        if (!(n->head[i] = tensor_create(c, T_F32, 1, &shape))) goto fail;
    }
    *out = n;
    return SHERF_OK;
fail:
    lpips_free(n);
    return SHERF_NO_MEMORY;
}

sherf_status lpips_place(context *c, lpips_network *n, const tensor_memory *memory) {
    sherf_status status = SHERF_OK;
    for (int i = 0; n && i < LPIPS_CONVOLUTIONS && status == SHERF_OK; i++) {
        status = tensor_place(c, n->weight[i], memory);
        if (status == SHERF_OK) status = tensor_place(c, n->bias[i], memory);
    }
    for (int i = 0; n && i < LPIPS_STAGES && status == SHERF_OK; i++)
        status = tensor_place(c, n->head[i], memory);
    return status;
}

/* Adds a stage's distance to `sum` as soon as both pictures have reached it. */
tensor *lpips_distance(tape *t, const lpips_network *n, tensor *a, tensor *b) {
    static const shift_scale_attr scaling = {.shift = {-.030f, -.088f, -.188f},
                                             .scale = {.458f, .448f, .450f}};
    tensor *x[2] = {op_shift_scale(t, a, &scaling), op_shift_scale(t, b, &scaling)};
    tensor *sum = NULL;
    for (int i = 0; i < LPIPS_CONVOLUTIONS; i++) {
        bool first = i && lpips_layers[i].stage != lpips_layers[i - 1].stage;
        bool last = i + 1 == LPIPS_CONVOLUTIONS || lpips_layers[i + 1].stage != lpips_layers[i].stage;
        for (int side = 0; side < 2; side++) {
            if (first) x[side] = op_max_pool(t, x[side], 2, 2, 0);
            x[side] = op_conv2d(t, x[side], n->weight[i], 1, 1, 1);
            x[side] = op_bias_act(t, x[side], n->bias[i], 0, 1, 0);
        }
        if (!last) continue;
        tensor *d = op_feature_distance(t, x[0], x[1], n->head[lpips_layers[i].stage]);
        sum = sum ? op_add(t, sum, d) : d;
    }
    return sum;
}
