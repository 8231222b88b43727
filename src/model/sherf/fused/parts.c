/* A prepared network as plain arrays: views of what radiance_field_start and radiance_matrices_make made. */
#include "model/sherf/fused/parts.h"

#include <string.h>

#include "model/sherf/fused/inside.h"

typedef struct {
    radiance_field *n;
    radiance_matrices m;
} owner;

static radiance_part_map map_of(const radiance_map *m) {
    return (radiance_part_map){m->width, m->height, m->stride, m->texel};
}

static radiance_part_matrix matrix_of(const radiance_matrix *m) {
    return (radiance_part_matrix){m->rows, m->columns, m->w, m->b};
}

static radiance_part_level level_of(const radiance_level *l) {
    const int64_t cells = (int64_t)(l->size[0] + 1) * (l->size[1] + 1) * (l->size[2] + 1);
    radiance_part_level out = {
        .cell = l->cell, .corner = l->corner[0], .rows = l->rows, .stride = l->stride, .value = l->value};
    memcpy(out.size, l->size, sizeof out.size);
    memcpy(out.voxels_per_m, l->voxels_per_m, sizeof out.voxels_per_m);
    for (int64_t i = 0; i < cells;
         i++) /* they are numbered from 0 in the order of the first voxels that touch them */
        if (l->cell[i] >= out.corners) out.corners = l->cell[i] + 1;
    return out;
}

static void fill(const context *c, const owner *own, radiance_parts *p) {
    const radiance_field *n = own->n;
    uint32_t bits = 0;
    *p = (radiance_parts){.s = n->s,
                          .fused = n->fused,
                          .position_width = n->position_width,
                          .direction_width = n->direction_width,
                          .color_width = n->color_width,
                          .color_token = n->color_token,
                          .map_tokens = n->map_tokens,
                          .attention_width = n->attention_width,
                          .map = map_of(&n->map),
                          .image_width = n->image_width,
                          .image_height = n->image_height,
                          .image = n->image,
                          .norm0_w = n->norm0_w,
                          .norm0_b = n->norm0_b,
                          .norm1_w = n->norm1_w,
                          .norm1_b = n->norm1_b,
                          .token_b = n->token_b};
#define TAKE(name) p->name = matrix_of(&own->m.name);
    RADIANCE_LAYERS(TAKE)
#undef TAKE
    memcpy(p->plane_min, n->plane_min, sizeof p->plane_min);
    memcpy(p->plane_scale, n->plane_scale, sizeof p->plane_scale);
    memcpy(p->map_scale, n->map_scale, sizeof p->map_scale);
    memcpy(p->image_scale, n->image_scale, sizeof p->image_scale);
    memcpy(p->volume_min, n->volume_min, sizeof p->volume_min);
    for (int i = 0; i < n->s.decoder_depth; i++) p->pts[i] = matrix_of(&own->m.pts[i]);
    bits = radiance_largest(c, n->map.texel, (int64_t)n->map.width * n->map.height * n->map.stride, bits);
    for (int i = 0; i < 3; i++) {
        p->plane[i] = map_of(&n->plane[i]);
        bits = radiance_largest(c, n->plane[i].texel,
                                (int64_t)n->plane[i].width * n->plane[i].height * n->plane[i].stride, bits);
    }
    for (int i = 0; i < POINT_LEVELS; i++) {
        p->level[i] = level_of(&n->level[i]);
        bits = radiance_largest(c, n->level[i].value, n->level[i].rows * n->level[i].stride, bits);
    }
    memcpy(&p->bank_top, &bits, sizeof bits);
}

sherf_status radiance_parts_create(context *c, const radiance_sizes *sizes, const radiance_weights *weights,
                                   const radiance_bank *bank, radiance_parts *out) {
    *out = (radiance_parts){0};
    if (bank->merged) return failure(c, SHERF_UNSUPPORTED, "radiance field: parts of a merged bank");
    owner *own = out->owner = mem_zero(c, 1, sizeof *own);
    if (!own) return SHERF_NO_MEMORY;
    sherf_status status = radiance_field_start(c, sizes, weights, bank, false, &own->m, &own->n);
    if (status == SHERF_OK) {
        fill(c, own, out);
        out->owner = own;
        return SHERF_OK;
    }
    radiance_parts_free(out);
    return status;
}

void radiance_parts_free(radiance_parts *p) {
    owner *own = p->owner;
    if (own) {
        radiance_field_free(own->n);
        radiance_matrices_free(&own->m);
    }
    mem_free(own);
    *p = (radiance_parts){0};
}
