/* Hierarchical features, the point-level ones (section 3.3; network.md 3): the observation's vertices carry
 * pixel-aligned features into a sparse canonical volume. */
#include <stdio.h>

#include "model/sherf/sherf.h"

void point_declare(declaration *d, const sherf_settings *k, point_stage *s) {
    const int *v = k->volume_channels, last = k->point_levels;
    char down[LAYER_NAME], conv[LAYER_NAME];
    s->levels = last;
    s->projection = linear_declare(d, "conv1d_projection", false, v[0], 3 * k->token_width);
    for (int i = 0; i < 2; i++)
        s->conv[0][i] = sparse_declare(d, "renderer.encoder_3d.conv0", 3 * i, true, v[0], v[0]);
    for (int l = 1; l <= last; l++) {
        snprintf(down, sizeof down, "renderer.encoder_3d.down%d", l - 1);
        snprintf(conv, sizeof conv, "renderer.encoder_3d.conv%d", l);
        s->down[l - 1] = sparse_declare(d, down, 0, true, v[l - 1], v[l > 1 ? l - 2 : 0]);
        for (int i = 0; i < (l == 1 ? 2 : POINT_CONVOLUTIONS); i++)
            s->conv[l][i] = sparse_declare(d, conv, 3 * i, true, v[l - 1], v[l - 1]);
    }
    /* runs in training only, to update its statistics; it is never trained */
    snprintf(down, sizeof down, "renderer.encoder_3d.down%d", last);
    s->down[last] = sparse_declare(d, down, 0, false, v[last - 1], v[last - 1]);
}

static tensor *rule_tensor(tape *t, const int32_t *rule, int64_t voxels) {
    return tape_input_i32(t, rule, 2, (int64_t[]){voxels, 27});
}

/* The 96 sampled values of each vertex, projected. Vertices that the camera does not see become 0, bias
 * included. */
static tensor *vertex_features(tape *t, const point_stage *s, const pixel_stage *pixel,
                               const sherf_geometry *g, const model_bank *bank, int64_t V) {
    tensor *x = linear_forward(t, &s->projection, pixel_sample(t, pixel, bank, g->vertex_px, V));
    return op_mask_rows(t, x, tape_input_i32(t, g->visible, 1, &V));
}

sherf_status point_encode(tape *t, const point_stage *s, const pixel_stage *pixel,
                          const observation_geometry *observation, model_bank *bank) {
    const sherf_geometry *g = model_sherf_geometry(observation);
    const int last = s->levels;
    int64_t V = observation->vertices;
    tensor *x = vertex_features(t, s, pixel, g, bank, V);
    x = op_scatter_mean(t, x, tape_input_i32(t, g->vertex_voxel, 1, &V), g->level[0].voxels);
    for (int l = 0; l <= last; l++) {
        if (l)
            x = sparse_forward(t, &s->down[l - 1], x,
                               rule_tensor(t, g->level[l - 1].down_rule, g->level[l].voxels));
        tensor *rule = rule_tensor(t, g->level[l].rule, g->level[l].voxels);
        for (int i = 0; i < POINT_CONVOLUTIONS && s->conv[l][i].w; i++)
            x = sparse_forward(t, &s->conv[l][i], x, rule);
        if (l) bank->tensor[BANK_LEVEL + l - 1] = x;
    }
    /* In training the layer after the last level still runs: its statistics move, its output is unused. */
    if (tape_settings(t).training && g->level[last].down_rule)
        sparse_forward(t, &s->down[last], x,
                       rule_tensor(t, g->level[last].down_rule, g->level[last + 1].voxels));
    return tape_status(t);
}

tensor *point_sample(tape *t, const observation_geometry *observation, const model_bank *bank,
                     const float *points_canonical, int64_t count) {
    const sherf_geometry *g = model_sherf_geometry(observation);
    tensor *out[POINT_LEVELS_MAX];
    for (int l = 0; l < g->levels; l++) {
        const tensor *values = bank->tensor[BANK_LEVEL + l];
        if (values && tensor_rows(values) != g->level[l + 1].voxels)
            return tape_fail(t, SHERF_MISMATCH, "level %d of the volume has %lld voxels, should be %lld",
                             l + 1, (long long)tensor_rows(values), (long long)g->level[l + 1].voxels);
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
        /* The grid is constant and large, so the tensor wraps the geometry's own memory instead of copying
         * it. */
        tensor *grid = tape_constant(t, T_I32, 3, cells, g->level[l + 1].grid);
        out[l] = op_sample_trilinear(t, bank->tensor[BANK_LEVEL + l], grid,
                                     tape_input(t, p, 2, (int64_t[]){count, 3}));
    }
    return g->levels > 1 ? op_concat(t, g->levels, out) : out[0];
}
