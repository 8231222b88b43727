/* Section 3: the observation's vertices carry pixel features into a sparse canonical volume. */
#include <stdio.h>

#include "model/sherf/sherf.h"

static const float volume_eps = 1e-3f, volume_momentum = 0.01f;

static tensor *sparse_layer(tape *t, const model *m, tensor *x, tensor *rule, const char *layer, int index) {
    char name[96];
    x = op_sparse_conv(t, x, model_tensor(m, "renderer.encoder_3d.%s.%d.weight", layer, index), rule);
    snprintf(name, sizeof name, "renderer.encoder_3d.%s.%d", layer, index + 1);
    return layer_batch_norm(t, m, x, name, volume_eps, volume_momentum, true);
}

static tensor *rule_tensor(tape *t, const int32_t *rule, int64_t voxels) {
    return tape_input_i32(t, rule, 2, (int64_t[]){voxels, 27});
}

/* 96 sampled values of each vertex, projected; what the camera does not see becomes 0, bias included. */
static tensor *vertex_features(tape *t, const model *m, const observation_geometry *g, const model_bank *bank,
                               int64_t V) {
    tensor *x = layer_linear(t, m, pixel_sample(t, m, bank, g->vertex_px, V), "conv1d_projection");
    return op_mask_rows(t, x, tape_input_i32(t, g->visible, 1, &V));
}

sherf_status volume_encode(tape *t, const model *m, const observation_geometry *g, model_bank *bank) {
    static const char *const conv[] = {"conv0", "conv1", "conv2", "conv3"};
    static const char *const down[] = {"down0", "down1", "down2", "down3"};
    static const int layers[] = {2, 2, 3, 3};
    int64_t V = g->vertices;
    tensor *x = vertex_features(t, m, g, bank, V);
    x = op_scatter_mean(t, x, tape_input_i32(t, g->vertex_voxel, 1, &V), g->level[0].voxels);
    for (int l = 0; l <= POINT_LEVELS; l++) {
        if (l)
            x = sparse_layer(t, m, x, rule_tensor(t, g->level[l - 1].down_rule, g->level[l].voxels),
                             down[l - 1], 0);
        tensor *rule = rule_tensor(t, g->level[l].rule, g->level[l].voxels);
        for (int i = 0; i < layers[l]; i++) x = sparse_layer(t, m, x, rule, conv[l], 3 * i);
        if (l) bank->level[l - 1] = x;
    }
    /* In training the layer after level 3 still runs: its statistics move, its output is unused. */
    const int last = POINT_LEVELS;
    if (tape_settings(t).training && g->level[last].down_rule)
        sparse_layer(t, m, x, rule_tensor(t, g->level[last].down_rule, g->level[last + 1].voxels), down[last],
                     0);
    return tape_status(t);
}

tensor *volume_sample(tape *t, const observation_geometry *g, const model_bank *bank,
                      const float *points_canonical, int64_t count) {
    tensor *out[POINT_LEVELS];
    for (int l = 0; l < POINT_LEVELS; l++) {
        const int *size = g->level[l + 1].size;
        float *p = tape_alloc(t, (size_t)count * 3, sizeof *p);
        if (!p) return NULL;
        for (int64_t i = 0; i < count * 3; i++) {
            int a = (int)(i % 3);
            float full = (float)g->volume_size[2 - a];
            float n = (points_canonical[i] - g->volume_min[a]) / g->voxel_size_m / full * 2 - 1;
            p[i] = (n + 1) / 2 * (float)(size[2 - a] - 1); /* corners aligned */
        }
        int64_t cells[3] = {size[0], size[1], size[2]};
        /* The grid is constant and large: a shell around the geometry's own memory, not a copy. */
        tensor *grid = tape_constant(t, T_I32, 3, cells, g->level[l + 1].grid);
        out[l] = op_sample_trilinear(t, bank->level[l], grid, tape_input(t, p, 2, (int64_t[]){count, 3}));
    }
    return op_concat(t, 3, out);
}
