/* A prepared network: the results of radiance_field_start and radiance_matrices_make. */
#include "model/sherf/fused/parts.h"

#include <string.h>

static float bank_max(const context *c, const radiance_field *n) {
    const radiance_map *map[] = {&n->map, &n->plane[0], &n->plane[1], &n->plane[2]};
    uint32_t bits = 0;
    float max;
    for (size_t i = 0; i < COUNT_OF(map); i++)
        bits = radiance_largest(c, map[i]->texel, (int64_t)map[i]->width * map[i]->height * map[i]->stride,
                                bits);
    for (int i = 0; i < POINT_LEVELS; i++)
        bits = radiance_largest(c, n->level[i].value, n->level[i].rows * n->level[i].stride, bits);
    memcpy(&max, &bits, sizeof max);
    return max;
}

sherf_status radiance_parts_create(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                   const radiance_bank *bank, radiance_parts *out) {
    radiance_field *n = NULL;
    *out = (radiance_parts){0};
    if (bank->merged) return failure(c, SHERF_UNSUPPORTED, "radiance field: parts of a merged bank");
    sherf_status status = radiance_field_start(c, sizes, weights, bank, false, &out->m, &n);
    out->n = n;
    if (status == SHERF_OK)
        out->bank_max = bank_max(c, n);
    else
        radiance_parts_free(out);
    return status;
}

void radiance_parts_free(radiance_parts *p) {
    radiance_field_free(p->n);
    radiance_matrices_free(&p->m);
    *p = (radiance_parts){0};
}
