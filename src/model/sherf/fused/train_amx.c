/* Preparation of the backward pass in bf16 on AMX, and what becomes of its sums: gradients of the weights as
 * the checkpoints have them. */
#if defined(__x86_64__)
#include <string.h>

#include "model/sherf/fused/train_amx.h"

bool radiance_training_amx_fits(const radiance_sizes *s) {
    return isa_has_bf16() && radiance_amx_fits(s) && s->feature_channels % s->token_width == 0 &&
           s->decoder_depth >= 2;
}

/* ---- transposed weights ---- */
/* Rows [0, count) of the result are columns `first`... of m; its column k is row k of m. */
static sherf_status pack_back(context *c, const radiance_matrix *m, int first, int count, int row_tiles,
                              int blocks, tiles *out) {
    radiance_matrix back = {.rows = count, .columns = m->rows};
    int *slot = mem_alloc(c, SLOTS, sizeof *slot);
    back.w = mem_alloc(c, (size_t)count * (size_t)m->rows, sizeof(float));
    back.b = mem_zero(c, (size_t)count, sizeof(float));
    sherf_status status = slot && back.w && back.b ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        for (int r = 0; r < count; r++)
            for (int k = 0; k < m->rows; k++)
                back.w[(size_t)r * (size_t)m->rows + (size_t)k] =
                    m->w[(size_t)k * (size_t)m->columns + (size_t)(first + r)];
        slots_none(slot);
        slots_add(slot, 0, 0, m->rows);
        status = tiles_pack(c, &back, row_tiles, blocks, slot, out);
    }
    mem_free(slot);
    mem_free(back.w);
    mem_free(back.b);
    return status;
}

/* views' first h columns and, `blocks_before` blocks of outputs further on, alpha's. */
static sherf_status pack_back_views(context *c, const radiance_matrices *m, int h, int view_blocks,
                                    int h_tiles, tiles *out) {
    const int before = view_blocks * 32;
    radiance_matrix both = {.rows = before + 1, .columns = h};
    both.w = mem_zero(c, (size_t)both.rows * (size_t)h, sizeof(float));
    if (!both.w) return SHERF_NO_MEMORY;
    for (int r = 0; r < m->views.rows; r++)
        memcpy(both.w + (size_t)r * (size_t)h, m->views.w + (size_t)r * (size_t)m->views.columns,
               (size_t)h * sizeof(float));
    memcpy(both.w + (size_t)before * (size_t)h, m->alpha.w, (size_t)h * sizeof(float));
    sherf_status status = pack_back(c, &both, 0, h, h_tiles, view_blocks + 1, out);
    mem_free(both.w);
    return status;
}

static sherf_status pack_all_back(context *c, radiance_matrices *m, amx_trainer *t) {
    const radiance_field *n = t->n;
    const radiance_amx *a = n->amx;
    const int h = n->s.decoder_width, x = n->position_width, skip = n->s.decoder_skip,
              h_tiles = 2 * a->h_blocks, all = n->attention_width;
    sherf_status s = pack_back(c, &m->rgb, 0, n->s.view_width, 2 * t->view_blocks, 1, &t->back.rgb);
    if (!s) s = pack_back_views(c, m, h, t->view_blocks, h_tiles, &t->back.views);
    if (!s) s = pack_back(c, &m->views, h + n->direction_width, WIDTH, 2, t->view_blocks, &t->back.token1);
    for (int i = 1; i < n->s.decoder_depth && !s; i++)
        s = pack_back(c, &m->pts[i], i == skip + 1 ? x + WIDTH : 0, h, h_tiles, a->h_blocks, &t->back.pts[i]);
    if (!s && skip >= 0) s = pack_back(c, &m->pts[skip + 1], x, WIDTH, 2, a->h_blocks, &t->back.skip_token0);
    if (!s) s = pack_back(c, &m->pts[0], x, WIDTH, 2, a->h_blocks, &t->back.token0);
    if (!s) s = pack_back(c, &m->mlp1, 0, WIDTH, 2, 1, &t->back.mlp1);
    if (!s) s = pack_back(c, &m->mlp0, 0, WIDTH, 2, 1, &t->back.mlp0);
    if (!s) s = pack_back(c, &m->attention_out, 0, all, all / 16, 1, &t->back.attention_out);
    for (int i = 0; i < all * WIDTH; i++)
        m->qkv.w[i] *= radiance_q_scale(n); /* as the forward pass has them */
    if (!s) s = pack_back(c, &m->qkv, 0, WIDTH, 2, t->qkv_blocks, &t->back.qkv);
    return s;
}

/* ---- where sums go ---- */
static size_t place_rows(amx_trainer *t, int rows) {
    size_t at = t->lane_floats;
    t->lane_floats += (size_t)rows * 16;
    return at;
}

static matrix_place place(amx_trainer *t, int row_blocks, int column_blocks) {
    matrix_place p = {.row_tiles = 2 * row_blocks, .column_tiles = 2 * column_blocks};
    p.w = t->lane_floats;
    t->lane_floats += (size_t)p.row_tiles * (size_t)p.column_tiles * 256;
    p.b = place_rows(t, row_blocks * 32);
    return p;
}

static void place_all(amx_trainer *t) {
    const radiance_field *n = t->n;
    const radiance_amx *a = n->amx;
    t->color = place(t, t->color_tokens, a->color.blocks);
    t->qkv = place(t, t->qkv_blocks, 1);
    t->attention_out = place(t, 1, a->mixed_blocks);
    t->mlp0 = place(t, 1, 1);
    t->mlp1 = place(t, 1, 1);
    for (int i = 0; i < n->s.decoder_depth; i++)
        t->pts[i] = place(t, a->h_blocks,
                          i == 0                       ? a->x_blocks
                          : i == n->s.decoder_skip + 1 ? a->x_blocks + a->h_blocks
                                                       : a->h_blocks);
    t->views = place(t, t->view_blocks + 1, a->h_blocks + a->v_blocks);
    t->rgb = place(t, 1, t->view_blocks);
    t->norm0_w = place_rows(t, WIDTH);
    t->norm0_b = place_rows(t, WIDTH);
    t->norm1_w = place_rows(t, WIDTH);
    t->norm1_b = place_rows(t, WIDTH);
    t->token_b = place_rows(t, 3 * WIDTH);
}

/* ---- from sums to the checkpoints' weights ---- */
/* out [rows][columns] += factor * the packed gradient's rows from `first` on; slot as it was packed. */
static void unpack(const float *lane, const matrix_place *p, int first, int rows, int columns,
                   const int *slot, float factor, float *out) {
    for (int r = first; r < first + rows; r++)
        for (int k = 0; k < p->column_tiles * 16; k++) {
            if (slot[k] < 0) continue;
            size_t at = ((size_t)(r / 32) * (size_t)(p->column_tiles / 2) + (size_t)(k / 32)) * 1024 +
                        (size_t)(r / 16 % 2 * 512 + k / 16 % 2 * 256 + r % 16 * 16 + k % 16);
            out[(size_t)(r - first) * (size_t)columns + (size_t)slot[k]] += factor * lane[p->w + at];
        }
}

static float row_sum(const float *lane, size_t at) {
    float sum = 0;
    for (int i = 0; i < 16; i++) sum += lane[at + (size_t)i];
    return sum;
}

static void add_rows(const float *lane, size_t at, int rows, float *out) {
    for (int r = 0; r < rows; r++) out[r] += row_sum(lane, at + (size_t)r * 16);
}

static void unpack_fusion(const amx_trainer *t, const float *lane, const radiance_weights *w,
                          const radiance_gradients *g, int *slot) {
    const radiance_field *n = t->n;
    const int all = n->attention_width;
    slots_none(slot);
    slots_add(slot, 0, 0, WIDTH);
    unpack(lane, &t->qkv, 0, all, WIDTH, slot, radiance_q_scale(n), radiance_gradient(g, w->qkv_w));
    unpack(lane, &t->qkv, all, 2 * all, WIDTH, slot, 1, radiance_gradient(g, w->qkv_w) + (size_t)all * WIDTH);
    unpack(lane, &t->mlp0, 0, WIDTH, WIDTH, slot, 1, radiance_gradient(g, w->mlp0_w));
    unpack(lane, &t->mlp1, 0, WIDTH, WIDTH, slot, 1, radiance_gradient(g, w->mlp1_w));
    slots_add(slot, 0, 0, all);
    unpack(lane, &t->attention_out, 0, WIDTH, all, slot, 1, radiance_gradient(g, w->attention_out_w));
    add_rows(lane, t->attention_out.b, WIDTH, radiance_gradient(g, w->attention_out_b));
    add_rows(lane, t->mlp0.b, WIDTH, radiance_gradient(g, w->mlp0_b));
    add_rows(lane, t->mlp1.b, WIDTH, radiance_gradient(g, w->mlp1_b));
    add_rows(lane, t->norm0_w, WIDTH, radiance_gradient(g, w->norm0_w));
    add_rows(lane, t->norm0_b, WIDTH, radiance_gradient(g, w->norm0_b));
    add_rows(lane, t->norm1_w, WIDTH, radiance_gradient(g, w->norm1_w));
    add_rows(lane, t->norm1_b, WIDTH, radiance_gradient(g, w->norm1_b));
}

/* Colour's columns of the token projection, and the biases: token i has b + W_v b_volume[i]. */
static void unpack_tokens(const amx_trainer *t, const float *lane, const radiance_weights *w,
                          const radiance_gradients *g, int *slot) {
    const radiance_field *n = t->n;
    const int f = n->s.feature_channels;
    float *dw = radiance_gradient(g, w->token_projection_w);
    for (int i = 0; i < t->color_tokens; i++) {
        slots_none(slot);
        for (int q = 0; q < n->color_width; q++)
            if ((f + q) / WIDTH - n->color_token == i) slot[q] = WIDTH + (f + q) % WIDTH;
        unpack(lane, &t->color, i * WIDTH, WIDTH, n->fused, slot, 1, dw);
    }
    float d[3 * WIDTH];
    for (int r = 0; r < n->fused; r++) d[r] = row_sum(lane, t->token_b + (size_t)r * 16);
    radiance_give_token_biases(n, w, g, d);
}

static sherf_status unpack_decoder(context *c, const amx_trainer *t, const float *lane,
                                   const radiance_weights *w, const radiance_gradients *g, int *slot) {
    const radiance_field *n = t->n;
    const radiance_amx *a = n->amx;
    const int h = n->s.decoder_width, x = n->position_width + WIDTH, view = n->s.view_width;
    for (int i = 0; i < n->s.decoder_depth; i++) {
        const bool first = i == 0, wide = !first && i == n->s.decoder_skip + 1;
        slots_none(slot);
        if (first || wide) slots_add_encoded(slot, 0, 0, n->position_width);
        if (!first) slots_add(slot, wide ? a->x_blocks * 32 : 0, wide ? x : 0, h);
        unpack(lane, &t->pts[i], 0, h,
               first  ? x
               : wide ? x + h
                      : h,
               slot, 1, radiance_gradient(g, w->pts_w[i]));
        add_rows(lane, t->pts[i].b, h, radiance_gradient(g, w->pts_b[i]));
    }
    slots_none(slot);
    slots_add(slot, 0, 0, h);
    unpack(lane, &t->views, 32 * t->view_blocks, 1, h, slot, 1, radiance_gradient(g, w->alpha_w));
    add_rows(lane, t->views.b + (size_t)t->view_blocks * 512, 1, radiance_gradient(g, w->alpha_b));
    float *dm = mem_zero(c, (size_t)view * ((size_t)h + 1), sizeof *dm);
    if (!dm) return SHERF_NO_MEMORY;
    float *db = dm + (size_t)view * (size_t)h;
    unpack(lane, &t->views, 0, view, h, slot, 1, dm);
    add_rows(lane, t->views.b, view, db);
    radiance_give_views(n, w, g, dm, db);
    add_rows(lane, t->views.b, view, radiance_gradient(g, w->views_b));
    mem_free(dm);
    slots_none(slot);
    slots_add_encoded(slot, a->h_blocks * 32, h, n->direction_width);
    unpack(lane, &t->views, 0, view, h + n->direction_width + WIDTH, slot, 1,
           radiance_gradient(g, w->views_w));
    slots_none(slot);
    slots_add(slot, 0, 0, view);
    unpack(lane, &t->rgb, 0, 3, view, slot, 1, radiance_gradient(g, w->rgb_w));
    add_rows(lane, t->rgb.b, 3, radiance_gradient(g, w->rgb_b));
    return SHERF_OK;
}

static sherf_status give_all(context *c, const radiance_trainer *r, const float *lane,
                             const radiance_weights *w, const radiance_gradients *out) {
    const amx_trainer *t = (const amx_trainer *)r;
    int *slot = mem_alloc(c, SLOTS, sizeof *slot);
    if (!slot) return SHERF_NO_MEMORY;
    unpack_fusion(t, lane, w, out, slot);
    unpack_tokens(t, lane, w, out, slot);
    sherf_status status = unpack_decoder(c, t, lane, w, out, slot);
    mem_free(slot);
    return status;
}

/* ---- making ---- */
static void release(radiance_trainer *r) {
    amx_trainer *t = (amx_trainer *)r;
#define FREE(of, name) tiles_free(&of.name);
    RADIANCE_BACK_LAYERS(FREE, t->back)
#undef FREE
    for (int i = 0; i < POINT_DECODER_MAX; i++) tiles_free(&t->back.pts[i]);
    mem_free(t);
}

sherf_status radiance_trainer_amx(context *c, const radiance_field *n, radiance_matrices *m,
                                  radiance_trainer **out) {
    amx_trainer *t = mem_zero(c, 1, sizeof *t);
    if (!t) return SHERF_NO_MEMORY;
    t->n = n;
    t->view_blocks = (n->s.view_width + 31) / 32;
    t->qkv_blocks = (3 * n->attention_width + 31) / 32;
    t->color_tokens = n->color_width ? 3 - n->color_token : 0;
    place_all(t);
    sherf_status status = pack_all_back(c, m, t);
    t->base = (radiance_trainer){.n = n,
                                 .lane_floats = t->lane_floats,
                                 .scratch_bytes = radiance_train_scratch_bytes(t),
                                 .scatter_jobs = AMX_SCATTER_JOBS,
                                 .tile = radiance_train_tile_amx,
                                 .scatter = radiance_scatter_amx,
                                 .give = give_all,
                                 .release = release};
    if (status)
        release(&t->base);
    else
        *out = &t->base;
    return status;
}
#else
typedef int nothing_here;
#endif
