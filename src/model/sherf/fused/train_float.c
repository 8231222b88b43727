/* Preparation of the backward pass in float32, and what becomes of its sums: gradients of the weights as the
 * checkpoints have them. */
#include "model/sherf/fused/train_float.h"

#include <string.h>

bool radiance_training_float_fits(const radiance_sizes *s) {
    return s->token_width % POINT_PAD == 0 && s->feature_channels % s->token_width == 0 &&
           s->decoder_depth >= 2;
}

/* ---- the layers ---- */
static sherf_status forwards(context *c, int block, const radiance_matrix *m, radiance_layer *out) {
    return radiance_layer_pack(c, block, true, m->rows, m->columns, m->w, m->columns, 1, m->b, out);
}

/* From the gradient of m's result to that of its inputs [first, first + count). */
static sherf_status backwards(context *c, int block, const radiance_matrix *m, int first, int count,
                              radiance_layer *out) {
    return radiance_layer_pack(c, block, true, count, m->rows, m->w + first, 1, m->columns, NULL, out);
}

/* views' first h columns and, as one output more, alpha's. */
static sherf_status backwards_views(context *c, int block, const radiance_matrices *m, int h,
                                    radiance_layer *out) {
    radiance_matrix both = {.rows = m->views.rows + 1, .columns = h};
    both.w = mem_alloc(c, (size_t)both.rows * (size_t)h, sizeof(float));
    if (!both.w) return SHERF_NO_MEMORY;
    for (int r = 0; r < m->views.rows; r++)
        memcpy(both.w + (size_t)r * (size_t)h, m->views.w + (size_t)r * (size_t)m->views.columns,
               (size_t)h * sizeof(float));
    memcpy(both.w + (size_t)m->views.rows * (size_t)h, m->alpha.w, (size_t)h * sizeof(float));
    sherf_status status = backwards(c, block, &both, 0, h, out);
    mem_free(both.w);
    return status;
}

static sherf_status pack_all(context *c, const radiance_matrices *m, float_trainer *t) {
    const radiance_field *n = t->n;
    const int rows = t->kernels->rows, width = n->s.token_width, h = n->s.decoder_width,
              x = n->position_width, skip = n->s.decoder_skip;
    sherf_status s = SHERF_OK;
#define FORWARDS(to, name)                                                                                   \
    if (!s && m->name.w) s = forwards(c, rows, &m->name, &to->name);
    RADIANCE_LAYERS(FORWARDS, t)
#undef FORWARDS
    for (int i = 0; i < n->s.decoder_depth && !s; i++) s = forwards(c, rows, &m->pts[i], &t->pts[i]);
    if (!s) s = backwards(c, rows, &m->rgb, 0, n->s.view_width, &t->back.rgb);
    if (!s) s = backwards_views(c, rows, m, h, &t->back.views);
    if (!s) s = backwards(c, rows, &m->views, h + n->direction_width, width, &t->back.token1);
    for (int i = 1; i < n->s.decoder_depth && !s; i++)
        s = backwards(c, rows, &m->pts[i], i == skip + 1 ? x + width : 0, h, &t->back.pts[i]);
    if (!s && skip >= 0) s = backwards(c, rows, &m->pts[skip + 1], x, width, &t->back.skip_token0);
    if (!s) s = backwards(c, rows, &m->pts[0], x, width, &t->back.token0);
    if (!s) s = backwards(c, rows, &m->mlp1, 0, width, &t->back.mlp1);
    if (!s) s = backwards(c, rows, &m->mlp0, 0, width, &t->back.mlp0);
    if (!s) s = backwards(c, rows, &m->attention_out, 0, n->attention_width, &t->back.attention_out);
    if (!s) s = backwards(c, rows, &m->qkv, 0, width, &t->back.qkv);
    return s;
}

/* ---- where sums go ---- */
static size_t place_rows(float_trainer *t, int rows) {
    const size_t at = t->base.lane_floats;
    t->base.lane_floats += (size_t)rows * 16; /* whole cache lines */
    return at;
}

static float_place place(float_trainer *t, int rows, int columns) {
    const train_float_kernels *k = t->kernels;
    float_place p = {rows, columns, round_up(rows, k->rows), t->base.lane_floats, 0};
    t->base.lane_floats += (size_t)round_up((int)p.padded_rows * round_up(columns, k->strip), 16);
    p.b = place_rows(t, rows);
    return p;
}

static void place_all(float_trainer *t) {
    const radiance_field *n = t->n;
    const int width = n->s.token_width;
    if (n->color_width) t->sum.color = place(t, t->color.rows, n->color_width);
    t->sum.qkv = place(t, 3 * n->attention_width, width);
    t->sum.attention_out = place(t, width, n->attention_width);
    t->sum.mlp0 = place(t, width, width);
    t->sum.mlp1 = place(t, width, width);
    for (int i = 0; i < n->s.decoder_depth; i++)
        t->sum.pts[i] = place(t, n->s.decoder_width, t->pts[i].columns);
    t->sum.views = place(t, n->s.view_width + 1, t->views.columns);
    t->sum.rgb = place(t, 3, n->s.view_width);
    t->norm0_w = place_rows(t, width);
    t->norm0_b = place_rows(t, width);
    t->norm1_w = place_rows(t, width);
    t->norm1_b = place_rows(t, width);
    t->token_b = place_rows(t, n->fused);
}

/* ---- from sums to the checkpoints' weights ---- */
static float sum_at(const float_trainer *t, const float *lane, const float_place *p, int row, int column) {
    const int strip = t->kernels->strip;
    return lane[p->w + ((size_t)(column / strip) * (size_t)p->padded_rows + (size_t)row) * (size_t)strip +
                (size_t)(column % strip)];
}

/* out [rows][pitch], from column 0 on, += the gradient's rows and columns from first and from on. */
static void add_matrix(const float_trainer *t, const float *lane, const float_place *p, int first, int rows,
                       int from, int columns, int pitch, float *out) {
    for (int r = 0; r < rows; r++)
        for (int k = 0; k < columns; k++)
            out[(size_t)r * (size_t)pitch + (size_t)k] += sum_at(t, lane, p, first + r, from + k);
}

static float row_sum(const float_trainer *t, const float *lane, size_t at) {
    float sum = 0;
    for (int i = 0; i < t->kernels->lanes; i++) sum += lane[at + (size_t)i];
    return sum;
}

static void add_rows(const float_trainer *t, const float *lane, size_t at, int rows, float *out) {
    for (int r = 0; r < rows; r++) out[r] += row_sum(t, lane, at + (size_t)(r * t->kernels->lanes));
}

static void add_layer(const float_trainer *t, const float *lane, const float_place *p, float *w, float *b) {
    add_matrix(t, lane, p, 0, p->rows, 0, p->columns, p->columns, w);
    if (b) add_rows(t, lane, p->b, p->rows, b);
}

static void give_fusion(const float_trainer *t, const float *lane, const radiance_weights *w,
                        const radiance_gradients *g) {
    const int width = t->n->s.token_width;
    add_layer(t, lane, &t->sum.qkv, radiance_gradient(g, w->qkv_w), NULL);
    add_layer(t, lane, &t->sum.attention_out, radiance_gradient(g, w->attention_out_w),
              radiance_gradient(g, w->attention_out_b));
    add_layer(t, lane, &t->sum.mlp0, radiance_gradient(g, w->mlp0_w), radiance_gradient(g, w->mlp0_b));
    add_layer(t, lane, &t->sum.mlp1, radiance_gradient(g, w->mlp1_w), radiance_gradient(g, w->mlp1_b));
    add_rows(t, lane, t->norm0_w, width, radiance_gradient(g, w->norm0_w));
    add_rows(t, lane, t->norm0_b, width, radiance_gradient(g, w->norm0_b));
    add_rows(t, lane, t->norm1_w, width, radiance_gradient(g, w->norm1_w));
    add_rows(t, lane, t->norm1_b, width, radiance_gradient(g, w->norm1_b));
}

/* Colour's columns of the token projection, and the biases. */
static sherf_status give_tokens(context *c, const float_trainer *t, const float *lane,
                                const radiance_weights *w, const radiance_gradients *g) {
    const radiance_field *n = t->n;
    const int width = n->s.token_width;
    float *dw = radiance_gradient(g, w->token_projection_w);
    for (int q = 0; q < n->color_width; q++) {
        const int at = n->s.feature_channels + q, first = (at / width - n->color_token) * width;
        for (int r = 0; r < width; r++)
            dw[(size_t)r * (size_t)n->fused + (size_t)(width + at % width)] +=
                sum_at(t, lane, &t->sum.color, first + r, q);
    }
    float *d = mem_zero(c, (size_t)n->fused, sizeof *d);
    if (!d) return SHERF_NO_MEMORY;
    add_rows(t, lane, t->token_b, n->fused, d);
    radiance_give_token_biases(n, w, g, d);
    mem_free(d);
    return SHERF_OK;
}

static sherf_status give_decoder(context *c, const float_trainer *t, const float *lane,
                                 const radiance_weights *w, const radiance_gradients *g) {
    const radiance_field *n = t->n;
    const int h = n->s.decoder_width, view = n->s.view_width, rest = n->direction_width + n->s.token_width;
    const float_place *p = &t->sum.views;
    for (int i = 0; i < n->s.decoder_depth; i++)
        add_layer(t, lane, &t->sum.pts[i], radiance_gradient(g, w->pts_w[i]),
                  radiance_gradient(g, w->pts_b[i]));
    add_matrix(t, lane, p, view, 1, 0, h, h, radiance_gradient(g, w->alpha_w));
    add_rows(t, lane, p->b + (size_t)(view * t->kernels->lanes), 1, radiance_gradient(g, w->alpha_b));
    float *dm = mem_zero(c, (size_t)view * ((size_t)h + 1), sizeof *dm);
    if (!dm) return SHERF_NO_MEMORY;
    float *db = dm + (size_t)view * (size_t)h;
    add_matrix(t, lane, p, 0, view, 0, h, h, dm);
    add_rows(t, lane, p->b, view, db);
    radiance_give_views(n, w, g, dm, db);
    mem_free(dm);
    add_rows(t, lane, p->b, view, radiance_gradient(g, w->views_b));
    add_matrix(t, lane, p, 0, view, h, rest, h + rest, radiance_gradient(g, w->views_w) + h);
    add_layer(t, lane, &t->sum.rgb, radiance_gradient(g, w->rgb_w), radiance_gradient(g, w->rgb_b));
    return SHERF_OK;
}

static sherf_status give_all(context *c, const radiance_trainer *r, const float *lane,
                             const radiance_weights *w, const radiance_gradients *out) {
    const float_trainer *t = (const float_trainer *)r;
    give_fusion(t, lane, w, out);
    sherf_status status = give_tokens(c, t, lane, w, out);
    return status ? status : give_decoder(c, t, lane, w, out);
}

/* ---- making ---- */
static void release(radiance_trainer *r) {
    float_trainer *t = (float_trainer *)r;
#define FREE(of, name) radiance_layer_free(&of.name);
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
    t->n = n;
    t->kernels = ISA_CHOICE(n->isa, &train_float);
    t->base = (radiance_trainer){.n = n,
                                 .scatter_jobs = FLOAT_SCATTER_JOBS,
                                 .tile = t->kernels->tile,
                                 .scatter = t->kernels->scatter,
                                 .give = give_all,
                                 .release = release};
    sherf_status status = pack_all(c, m, t);
    if (status) {
        release(&t->base);
        return status;
    }
    place_all(t);
    t->base.scratch_bytes = t->kernels->scratch_bytes(&t->base);
    *out = &t->base;
    return SHERF_OK;
}
