/* Joins an encoder's stages side by side. */
#include "model/stages.h"

#include <math.h>

sherf_status encoder_check(context *c, int layers) {
    if (layers == 18 || layers == 34) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "model setting encoder=%d: must be 18 or 34, a ResNet's layers",
                   layers);
}

static tensor *resized(tape *t, tensor *map, int64_t height, int64_t width) {
    if (!map || (map->dim[0] == height && map->dim[1] == width)) return map;
    const double down = height > 1 ? (double)(map->dim[0] - 1) / (double)(height - 1) : 0;
    const double right = width > 1 ? (double)(map->dim[1] - 1) / (double)(width - 1) : 0;
    float *at = tape_alloc(t, (size_t)(height * width), 2 * sizeof *at);
    if (!at) return NULL;
    for (int64_t i = 0; i < height * width; i++) {
        at[2 * i] = fminf((float)((double)(i % width) * right), (float)(map->dim[1] - 1));
        at[2 * i + 1] = fminf((float)((double)(i / width) * down), (float)(map->dim[0] - 1));
    }
    tensor *y = op_sample_bilinear(t, map, tape_input(t, at, 2, (int64_t[]){height * width, 2}));
    return y ? tape_reshape(t, y, 3, (int64_t[]){height, width, tensor_columns(map)}) : NULL;
}

tensor *stages_side_by_side(tape *t, int count, tensor *const *stage) {
    tensor *all[4] = {NULL};
    if (!stage[0]) return NULL;
    for (int i = 0; i < count; i++) all[i] = resized(t, stage[i], stage[0]->dim[0], stage[0]->dim[1]);
    return op_concat(t, count, all);
}

map_place map_place_of(const tensor *map, int width, int height) {
    return (map_place){(float)map->dim[1] / (float)width, (float)map->dim[0] / (float)height,
                       (float)(map->dim[1] - 1), (float)(map->dim[0] - 1)};
}

void map_position(const map_place *p, const float px[2], float out[2]) {
    out[0] = fminf(fmaxf(px[0] * p->across, 0), p->right); /* NaN becomes 0 */
    out[1] = fminf(fmaxf(px[1] * p->down, 0), p->bottom);
}
