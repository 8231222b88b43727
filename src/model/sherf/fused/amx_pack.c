/* The weights of the radiance field as AMX tiles of bf16. */
#if defined(__x86_64__)
#include <math.h>
#include <string.h>

#include "model/sherf/fused/amx_pack.h"

static uint16_t to_bf16(float x) {
    uint32_t u;
    memcpy(&u, &x, 4);
    return (uint16_t)((u + 0x7fffu + (u >> 16 & 1u)) >> 16);
}

static float from_bf16(uint16_t x) {
    uint32_t u = (uint32_t)x << 16;
    float y;
    memcpy(&y, &u, 4);
    return y;
}
/* slot[i]: the column of m for input i of the packed layer; -1: none. */
sherf_status tiles_pack(context *c, const radiance_matrix *m, int row_tiles, int blocks, const int *slot,
                        tiles *out) {
    *out = (tiles){.row_tiles = row_tiles, .blocks = blocks};
    out->w = mem_zero(c, (size_t)row_tiles * (size_t)blocks, TILE);
    out->bias = mem_zero(c, (size_t)row_tiles * 16, sizeof(float));
    if (!out->w || !out->bias) return SHERF_NO_MEMORY;
    for (int r = 0; r < m->rows; r++) {
        out->bias[r] = m->b[r];
        int tile = r / 16, pair = tile / 2;
        int width = 2 * pair + 1 < row_tiles ? 2 : 1; /* row tiles side by side */
        for (int k = 0; k < blocks * 32; k++) {
            if (slot[k] < 0) continue;
            size_t at = ((size_t)pair * 2 * (size_t)blocks + (size_t)(k / 32 * width + tile % 2)) * 512 +
                        (size_t)(r % 16 * 32 + k % 32);
            out->w[at] = to_bf16(m->w[(size_t)r * (size_t)m->columns + (size_t)slot[k]]);
        }
    }
    return SHERF_OK;
}

static void slots_none(int *slot) {
    for (int i = 0; i < SLOTS; i++) slot[i] = -1;
}

/* slots [at, at + count) read columns from `column` on */
static void slots_add(int *slot, int at, int column, int count) {
    for (int i = 0; i < count; i++) slot[at + i] = column + i;
}

/* [encoding of `width` values, the three low parts of its first ones, a token] */
static void slots_add_encoded(int *slot, int at, int column, int width) {
    slots_add(slot, at, column, width);
    slots_add(slot, at + width, column, 3);
    slots_add(slot, at + width + 3, column + width, WIDTH);
}

void slots_plain(int *slot, int count) {
    slots_none(slot);
    slots_add(slot, 0, 0, count);
}

void slots_pts(const radiance_field *n, int i, int *slot) {
    const bool first = i == 0, wide = !first && i == n->s.decoder_skip + 1;
    slots_none(slot);
    if (first || wide) slots_add_encoded(slot, 0, 0, n->position_width);
    if (!first)
        slots_add(slot, wide ? n->amx->x_blocks * 32 : 0, wide ? n->position_width + WIDTH : 0,
                  n->s.decoder_width);
}

void slots_views(const radiance_field *n, int *slot) {
    slots_plain(slot, n->s.decoder_width);
    slots_add_encoded(slot, n->amx->h_blocks * 32, n->s.decoder_width, n->direction_width);
}

/* Twice the rows: the bits of the weights that bf16 keeps, then those that it drops. */
static sherf_status pack_precise(context *c, const radiance_matrix *m, int blocks, const int *slot,
                                 tiles *out) {
    radiance_matrix two = {.rows = 2 * m->rows, .columns = m->columns};
    size_t count = (size_t)m->rows * (size_t)m->columns;
    two.w = mem_alloc(c, 2 * count, sizeof(float));
    two.b = mem_zero(c, (size_t)two.rows, sizeof(float));
    sherf_status status = two.w && two.b ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        for (size_t i = 0; i < count; i++) {
            two.w[i] = from_bf16(to_bf16(m->w[i]));
            two.w[count + i] = m->w[i] - two.w[i];
        }
        memcpy(two.b, m->b, (size_t)m->rows * sizeof(float));
        status = tiles_pack(c, &two, 1, blocks, slot, out);
    }
    mem_free(two.w);
    mem_free(two.b);
    return status;
}

/* attention_out with its bias as two more columns (its high and low part), which are multiplied by ones. */
static sherf_status pack_attention_out(context *c, const radiance_matrix *m, int blocks, int *slot,
                                       tiles *out) {
    radiance_matrix wide = {.rows = m->rows, .columns = m->columns + 2};
    wide.w = mem_alloc(c, (size_t)wide.rows * (size_t)wide.columns, sizeof(float));
    wide.b = mem_zero(c, (size_t)wide.rows, sizeof(float));
    sherf_status status = wide.w && wide.b ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        for (int r = 0; r < m->rows; r++) {
            float *w = wide.w + (size_t)r * (size_t)wide.columns;
            memcpy(w, m->w + (size_t)r * (size_t)m->columns, (size_t)m->columns * sizeof(float));
            w[m->columns] = from_bf16(to_bf16(m->b[r]));
            w[m->columns + 1] = m->b[r] - w[m->columns];
        }
        slots_plain(slot, wide.columns);
        status = tiles_pack(c, &wide, 2, blocks, slot, out);
    }
    mem_free(wide.w);
    mem_free(wide.b);
    return status;
}

float radiance_q_scale(const radiance_field *n) {
    return 1.44269504f / sqrtf((float)n->s.head_width);
}

static sherf_status pack_fusion(context *c, const radiance_field *n, radiance_matrices *m, int *slot,
                                radiance_amx *a) {
    sherf_status status = SHERF_OK;
    slots_plain(slot, n->color_width);
    if (n->color_width)
        status = tiles_pack(c, &m->color, m->color.rows / 16, (n->color_width + 31) / 32, slot, &a->color);
    /* q includes attention's scale and log2 e */
    for (int i = 0; i < n->attention_width * WIDTH; i++) m->qkv.w[i] *= radiance_q_scale(n);
    slots_plain(slot, WIDTH);
    if (!status) status = tiles_pack(c, &m->qkv, (3 * n->attention_width + 15) / 16, 1, slot, &a->qkv);
    if (!status) status = tiles_pack(c, &m->mlp0, 2, 1, slot, &a->mlp0);
    if (!status) status = tiles_pack(c, &m->mlp1, 2, 1, slot, &a->mlp1);
    if (!status) status = pack_attention_out(c, &m->attention_out, a->mixed_blocks, slot, &a->attention_out);
    a->mlp1_b = status ? NULL : mem_alloc(c, WIDTH, sizeof(float));
    if (a->mlp1_b) memcpy(a->mlp1_b, m->mlp1.b, WIDTH * sizeof(float));
    return status ? status : a->mlp1_b ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status pack_decoder(context *c, const radiance_field *n, const radiance_matrices *m, int *slot,
                                 radiance_amx *a) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < n->s.decoder_depth && !status; i++) {
        const bool first = i == 0, wide = !first && i == n->s.decoder_skip + 1;
        slots_pts(n, i, slot);
        int blocks = first ? a->x_blocks : a->h_blocks + (wide ? a->x_blocks : 0);
        status = tiles_pack(c, &m->pts[i], 2 * a->h_blocks, blocks, slot, &a->pts[i]);
    }
    slots_plain(slot, n->s.decoder_width);
    if (!status) status = pack_precise(c, &m->alpha, a->h_blocks, slot, &a->alpha);
    slots_views(n, slot);
    int view_tiles = round_up(n->s.view_width, 32) / 16;
    if (!status) status = tiles_pack(c, &m->views, view_tiles, a->h_blocks + a->v_blocks, slot, &a->views);
    slots_plain(slot, n->s.view_width);
    if (!status) status = pack_precise(c, &m->rgb, view_tiles / 2, slot, &a->rgb);
    return status;
}

static void lay_out(radiance_field *n, radiance_amx *a) {
    size_t at = 0,
           wide = (size_t)(a->h_blocks > a->views.row_tiles / 2 ? a->h_blocks : a->views.row_tiles / 2);
    /* one more line, so that groups do not map to the same cache sets */
    a->x_pitch = (size_t)(a->x_blocks + a->h_blocks) * TILE + 64;
    a->v_pitch = (size_t)(a->h_blocks + a->v_blocks) * TILE + 64;
    a->h_pitch = wide * TILE + 64;
    size_t sums = (size_t)a->qkv.row_tiles * 3 * TILE;
    if (sums < 4 * (POINT_TILE / GROUP) * TILE) sums = 4 * (POINT_TILE / GROUP) * TILE;
    struct {
        size_t *place, bytes;
    } parts[] = {
        {&a->token, 3 * WIDTH * POINT_TILE * sizeof(float)},
        {&a->x, (POINT_TILE / GROUP) * a->x_pitch},
        {&a->v, (POINT_TILE / GROUP) * a->v_pitch},
        {&a->a, (POINT_TILE / GROUP) * a->h_pitch},
        {&a->b, (POINT_TILE / GROUP) * a->h_pitch},
        {&a->c, 2 * 1024 * sizeof(float)},
        {&a->sample, sizeof(samples)},
        {&a->row, (size_t)(6 + 6 * 16) * GROUP * sizeof(float)},
        {&a->color_tiles, (size_t)(a->color.blocks + 1) * TILE},
        {&a->normed, 3 * (POINT_TILE / GROUP) * TILE},
        {&a->mixed, 2 * (POINT_TILE / GROUP) * (size_t)a->mixed_blocks * TILE},
        {&a->sums, sums},
    };
    for (size_t i = 0; i < COUNT_OF(parts); i++) {
        *parts[i].place = at;
        at += (parts[i].bytes + 63) / 64 * 64;
    }
    n->scratch_bytes = at;
}

bool radiance_amx_fits(const radiance_sizes *s) {
    return s->token_width == WIDTH && s->head_width % 2 == 0 && s->heads * s->head_width % 16 == 0 &&
           s->heads * s->head_width <= 512 && s->decoder_width <= 1024;
}

sherf_status radiance_amx_create(context *c, radiance_field *n, radiance_matrices *m) {
    radiance_amx *a = n->amx = mem_zero(c, 1, sizeof *a);
    int *slot = a ? mem_alloc(c, SLOTS, sizeof *slot) : NULL;
    if (!slot) return SHERF_NO_MEMORY;
    a->h_blocks = (n->s.decoder_width + 31) / 32;
    a->x_blocks = (n->position_width + 3 + WIDTH + 31) / 32;
    a->v_blocks = (n->direction_width + 3 + WIDTH + 31) / 32;
    a->mixed_blocks = (n->attention_width + 2 + 31) / 32;
    sherf_status status = pack_fusion(c, n, m, slot, a);
    if (!status) status = pack_decoder(c, n, m, slot, a);
    mem_free(slot);
    lay_out(n, a);
    n->tile = radiance_tile_amx;
    return status;
}

void tiles_free(tiles *l) {
    mem_free(l->w);
    mem_free(l->bias);
}

void radiance_amx_free(radiance_amx *a) {
    if (!a) return;
#define FREE(of, name) tiles_free(&of->name);
    RADIANCE_LAYERS(FREE, a)
#undef FREE
    for (int i = 0; i < POINT_DECODER_MAX; i++) tiles_free(&a->pts[i]);
    mem_free(a->mlp1_b);
    mem_free(a);
}
#else
typedef int nothing_here;
#endif
