/* A prepared network as plain arrays: views of what point_network_start and point_matrices_make made. */
#include "model/sherf/fused/parts.h"

#include <string.h>

#include "model/sherf/fused/inside.h"

typedef struct {
    point_network *n;
    point_matrices m;
} owner;

static point_part_map map_of(const point_map *m) {
    return (point_part_map){m->width, m->height, m->stride, m->texel};
}

static point_part_matrix matrix_of(const point_matrix *m) {
    return (point_part_matrix){m->rows, m->columns, m->w, m->b};
}

static point_part_level level_of(const point_level *l) {
    const int64_t cells = (int64_t)(l->size[0] + 1) * (l->size[1] + 1) * (l->size[2] + 1);
    point_part_level out = {
        .cell = l->cell, .corner = l->corner[0], .rows = l->rows, .stride = l->stride, .value = l->value};
    memcpy(out.size, l->size, sizeof out.size);
    memcpy(out.voxels_per_m, l->voxels_per_m, sizeof out.voxels_per_m);
    for (int64_t i = 0; i < cells;
         i++) /* they are numbered from 0 in the order of the first voxels that touch them */
        if (l->cell[i] >= out.corners) out.corners = l->cell[i] + 1;
    return out;
}

static void fill(const context *c, const owner *own, point_parts *p) {
    const point_network *n = own->n;
    uint32_t bits = 0;
    *p = (point_parts){.s = n->s,
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
                       .token_b = n->token_b,
                       .color = matrix_of(&own->m.color),
                       .qkv = matrix_of(&own->m.qkv),
                       .attention_out = matrix_of(&own->m.attention_out),
                       .mlp0 = matrix_of(&own->m.mlp0),
                       .mlp1 = matrix_of(&own->m.mlp1),
                       .alpha = matrix_of(&own->m.alpha),
                       .views = matrix_of(&own->m.views),
                       .rgb = matrix_of(&own->m.rgb)};
    memcpy(p->plane_min, n->plane_min, sizeof p->plane_min);
    memcpy(p->plane_scale, n->plane_scale, sizeof p->plane_scale);
    memcpy(p->map_scale, n->map_scale, sizeof p->map_scale);
    memcpy(p->image_scale, n->image_scale, sizeof p->image_scale);
    memcpy(p->volume_min, n->volume_min, sizeof p->volume_min);
    for (int i = 0; i < n->s.decoder_depth; i++) p->pts[i] = matrix_of(&own->m.pts[i]);
    bits = point_largest(c, n->map.texel, (int64_t)n->map.width * n->map.height * n->map.stride, bits);
    for (int i = 0; i < 3; i++) {
        p->plane[i] = map_of(&n->plane[i]);
        bits = point_largest(c, n->plane[i].texel,
                             (int64_t)n->plane[i].width * n->plane[i].height * n->plane[i].stride, bits);
    }
    for (int i = 0; i < POINT_LEVELS; i++) {
        p->level[i] = level_of(&n->level[i]);
        bits = point_largest(c, n->level[i].value, n->level[i].rows * n->level[i].stride, bits);
    }
    memcpy(&p->bank_top, &bits, sizeof bits);
}

sherf_status point_parts_create(context *c, const point_sizes *sizes, const point_weights *weights,
                                const point_bank *bank, point_parts *out) {
    *out = (point_parts){0};
    if (bank->merged) return failure(c, SHERF_UNSUPPORTED, "point network: parts of a merged bank");
    owner *own = out->owner = mem_zero(c, 1, sizeof *own);
    if (!own) return SHERF_NO_MEMORY;
    sherf_status status = point_network_start(c, sizes, weights, bank, false, &own->m, &own->n);
    if (status == SHERF_OK) {
        fill(c, own, out);
        out->owner = own;
        return SHERF_OK;
    }
    point_parts_free(out);
    return status;
}

void point_parts_free(point_parts *p) {
    owner *own = p->owner;
    if (own) {
        point_network_free(own->n);
        point_matrices_free(&own->m);
    }
    mem_free(own);
    *p = (point_parts){0};
}
