/* The backward pass in bf16 on AMX: its preparation, and the layout of its sums. */
#if defined(__x86_64__)
#include "model/sherf/fused/train_amx.h"

bool radiance_training_amx_fits(const radiance_sizes *s) {
    return isa_has_bf16() && radiance_amx_fits(s) && s->feature_channels % s->token_width == 0 &&
           s->decoder_depth >= 2;
}

/* ---- transposed weights ---- */
/* Rows [0, count) of the result are columns `first`... of m; its column k is row k of m. m NULL: there is
 * none. */
static sherf_status pack_back(context *c, const radiance_matrix *m, int first, int count, tiles *out) {
    if (!m) return SHERF_OK;
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
        slots_plain(slot, m->rows);
        status = tiles_pack(c, &back, round_up(count, 32) / 16, (m->rows + 31) / 32, slot, out);
    }
    mem_free(slot);
    mem_free(back.w);
    mem_free(back.b);
    return status;
}

static sherf_status pack_all_back(context *c, radiance_matrices *m, amx_trainer *t) {
    const radiance_field *n = t->base.n;
    radiance_matrix both;
    sherf_status s = radiance_views_and_alpha(c, m, t->base.alpha_row, &both);
    for (int i = 0; i < n->attention_width * WIDTH; i++)
        m->qkv.w[i] *= t->base.q_scale; /* scaled as in the forward pass */
#define BACK(to, name, from, first, count)                                                                   \
    if (!s) s = pack_back(c, from, first, count, &to->back.name);
    RADIANCE_BACK_LAYERS(BACK, t)
#undef BACK
    for (int i = 1; i < n->s.decoder_depth && !s; i++)
        s = pack_back(c, &m->pts[i], radiance_hidden_column(n, i), n->s.decoder_width, &t->back.pts[i]);
    mem_free(both.w);
    return s;
}

/* ---- from sums to the checkpoints' weights ---- */
static void slots_of(const amx_trainer *t, const sum_place *p) {
    const radiance_field *n = t->base.n;
    if (p == &t->base.sum.views)
        slots_views(n, t->slot);
    else if (p >= t->base.sum.pts && p < t->base.sum.pts + POINT_DECODER_MAX)
        slots_pts(n, (int)(p - t->base.sum.pts), t->slot);
    else
        slots_plain(t->slot, p->columns);
}

static void add(const radiance_trainer *r, const float *lane, const sum_place *p, const sum_block *b,
                int pitch, float *out) {
    const int *slot = ((const amx_trainer *)r)->slot;
    slots_of((const amx_trainer *)r, p);
    for (int i = 0; i < b->rows; i++)
        for (int k = 0, row = b->first + i; k < p->padded_columns; k++) {
            if (slot[k] < b->from || slot[k] >= b->from + b->columns) continue;
            const size_t pair = (size_t)(row / 32) * (size_t)(p->padded_columns / 32) + (size_t)(k / 32);
            const int at = row / 16 % 2 * 512 + k / 16 % 2 * 256 + row % 16 * 16 + k % 16;
            out[(size_t)i * (size_t)pitch + (size_t)(slot[k] - b->from)] +=
                b->factor * lane[p->w + pair * 1024 + (size_t)at];
        }
}

/* ---- making ---- */
static void release(radiance_trainer *r) {
    amx_trainer *t = (amx_trainer *)r;
#define FREE(of, name, ...) tiles_free(&of.name);
    RADIANCE_BACK_LAYERS(FREE, t->back)
#undef FREE
    for (int i = 0; i < POINT_DECODER_MAX; i++) tiles_free(&t->back.pts[i]);
    mem_free(t->slot);
    mem_free(t);
}

static void place_all(amx_trainer *t, const radiance_matrices *m) {
    const radiance_amx *a = t->base.n->amx;
#define PAD(with, name) with->name.padded_columns = 32 * a->name.blocks;
    RADIANCE_LAYERS(PAD, (&t->base.sum))
#undef PAD
    for (int i = 0; i < t->base.n->s.decoder_depth; i++)
        t->base.sum.pts[i].padded_columns = 32 * a->pts[i].blocks;
    radiance_sums_place(&t->base, m);
}

sherf_status radiance_trainer_amx(context *c, const radiance_field *n, radiance_matrices *m,
                                  radiance_trainer **out) {
    amx_trainer *t = mem_zero(c, 1, sizeof *t);
    if (!t) return SHERF_NO_MEMORY;
    t->view_blocks = (n->s.view_width + 31) / 32;
    t->qkv_blocks = (3 * n->attention_width + 31) / 32;
    t->color_tokens = n->color_width ? 3 - n->color_token : 0;
    t->base = (radiance_trainer){.n = n,
                                 .row_block = 32,
                                 .column_block = 32,
                                 .row_lanes = 16,
                                 .alpha_row = 32 * t->view_blocks,
                                 .q_scale = radiance_q_scale(n),
                                 .scatter_jobs = AMX_SCATTER_JOBS,
                                 .tile = radiance_train_tile_amx,
                                 .scatter = radiance_scatter_amx,
                                 .add = add,
                                 .release = release};
    t->slot = mem_alloc(c, SLOTS, sizeof *t->slot);
    sherf_status status = t->slot ? pack_all_back(c, m, t) : SHERF_NO_MEMORY;
    if (status) {
        release(&t->base);
        return status;
    }
    place_all(t, m);
    t->base.scratch_bytes = radiance_train_scratch_bytes(t);
    *out = &t->base;
    return SHERF_OK;
}
#else
typedef int nothing_here;
#endif
