/* Preparation of the backward pass in float32, and turning its sums into gradients of the weights in the
 * checkpoints' layout. */
#include "model/sherf/fused/train_float.h"

bool radiance_training_float_fits(const radiance_sizes *s) {
    return s->token_width % POINT_PAD == 0 && s->feature_channels % s->token_width == 0 &&
           s->decoder_depth >= 2;
}

/* ---- the layers ---- */
static sherf_status forwards(context *c, int block, const radiance_matrix *m, radiance_layer *out) {
    return radiance_layer_pack(c, block, true, m->rows, m->columns, m->w, m->columns, 1, m->b, out);
}

/* From the gradient of m's result to that of its inputs [first, first + count); m NULL: there is none. */
static sherf_status backwards(context *c, int block, const radiance_matrix *m, int first, int count,
                              radiance_layer *out) {
    if (!m) return SHERF_OK;
    return radiance_layer_pack(c, block, true, count, m->rows, m->w + first, 1, m->columns, NULL, out);
}

static sherf_status pack_all(context *c, const radiance_matrices *m, float_trainer *t) {
    const radiance_field *n = t->base.n;
    const int rows = t->kernels->rows;
    radiance_matrix both;
    sherf_status s = radiance_views_and_alpha(c, m, t->base.alpha_row, &both);
#define FORWARDS(to, name)                                                                                   \
    if (!s && m->name.w) s = forwards(c, rows, &m->name, &to->name);
#define BACKWARDS(to, name, from, first, count)                                                              \
    if (!s) s = backwards(c, rows, from, first, count, &to->back.name);
    RADIANCE_LAYERS(FORWARDS, t)
    RADIANCE_BACK_LAYERS(BACKWARDS, t)
#undef FORWARDS
#undef BACKWARDS
    for (int i = 0; i < n->s.decoder_depth && !s; i++) s = forwards(c, rows, &m->pts[i], &t->pts[i]);
    for (int i = 1; i < n->s.decoder_depth && !s; i++)
        s = backwards(c, rows, &m->pts[i], radiance_hidden_column(n, i), n->s.decoder_width, &t->back.pts[i]);
    mem_free(both.w);
    return s;
}

static void add(const radiance_trainer *r, const float *lane, const sum_place *p, const sum_block *b,
                int pitch, float *out) {
    const int strip = r->column_block;
    for (int i = 0; i < b->rows; i++)
        for (int k = 0; k < b->columns; k++) {
            const size_t row = (size_t)(b->first + i), column = (size_t)(b->from + k), width = (size_t)strip;
            out[(size_t)i * (size_t)pitch + (size_t)k] +=
                b->factor *
                lane[p->w + (column / width * (size_t)p->padded_rows + row) * width + column % width];
        }
}

/* ---- making ---- */
static void release(radiance_trainer *r) {
    float_trainer *t = (float_trainer *)r;
#define FREE(of, name, ...) radiance_layer_free(&of.name);
    RADIANCE_LAYERS(FREE, (*t))
    RADIANCE_BACK_LAYERS(FREE, t->back)
#undef FREE
    for (int i = 0; i < POINT_DECODER_MAX; i++) {
        radiance_layer_free(&t->pts[i]);
        radiance_layer_free(&t->back.pts[i]);
    }
    mem_free(t);
}

sherf_status radiance_trainer_float(context *c, const radiance_field *n, radiance_matrices *m,
                                    radiance_trainer **out) {
    float_trainer *t = mem_zero(c, 1, sizeof *t);
    if (!t) return SHERF_NO_MEMORY;
    t->kernels = ISA_CHOICE(n->isa, &train_float);
    t->base = (radiance_trainer){.n = n,
                                 .row_block = t->kernels->rows,
                                 .column_block = t->kernels->strip,
                                 .row_lanes = t->kernels->lanes,
                                 .alpha_row = n->s.view_width,
                                 .q_scale = 1,
                                 .scatter_jobs = FLOAT_SCATTER_JOBS,
                                 .tile = t->kernels->tile,
                                 .scatter = t->kernels->scatter,
                                 .add = add,
                                 .release = release};
    sherf_status status = pack_all(c, m, t);
    if (status) {
        release(&t->base);
        return status;
    }
    radiance_sums_place(&t->base, m);
    t->base.scratch_bytes = t->kernels->scratch_bytes(&t->base);
    *out = &t->base;
    return SHERF_OK;
}
