/* The layout of a lane's sums in the backward pass, and their conversion to gradients of the weights in the
 * checkpoints' layout; the same for float32 and bf16. */
#include <string.h>

#include "model/sherf/fused/train_inside.h"

/* ---- the layout of sums ---- */
static size_t place_rows(radiance_trainer *t, int rows) {
    const size_t at = t->lane_floats;
    t->lane_floats += (size_t)rows * 16; /* whole cache lines */
    return at;
}

static void place(radiance_trainer *t, int rows, int columns, sum_place *p) {
    p->rows = rows;
    p->columns = columns;
    p->padded_rows = round_up(rows, t->row_block);
    if (!p->padded_columns) p->padded_columns = round_up(columns, t->column_block);
    p->w = t->lane_floats;
    t->lane_floats += (size_t)round_up(p->padded_rows * p->padded_columns, 16);
    p->b = place_rows(t, p->padded_rows);
}

void radiance_sums_place(radiance_trainer *t, const radiance_matrices *m) {
    const int width = t->n->s.token_width;
#define PLACE(name) place(t, m->name.rows, m->name.columns, &t->sum.name)
    if (t->n->color_width) PLACE(color);
    PLACE(qkv);
    PLACE(attention_out);
    PLACE(mlp0);
    PLACE(mlp1);
    for (int i = 0; i < t->n->s.decoder_depth; i++) PLACE(pts[i]);
    place(t, t->alpha_row + 1, m->views.columns, &t->sum.views);
    PLACE(rgb);
#undef PLACE
    t->norm0_w = place_rows(t, width);
    t->norm0_b = place_rows(t, width);
    t->norm1_w = place_rows(t, width);
    t->norm1_b = place_rows(t, width);
    t->token_b = place_rows(t, t->n->fused);
}

/* ---- from sums to gradients ---- */
typedef struct {
    const radiance_trainer *t;
    const float *lane;
    const radiance_weights *w;
    const radiance_gradients *g;
} giver;

static float *to(const giver *r, const float *weights) {
    return radiance_gradient(r->g, weights);
}

static void give_rows(const giver *r, size_t at, int rows, float *out) {
    for (int i = 0; i < rows; i++, at += (size_t)r->t->row_lanes) {
        float sum = 0;
        for (int k = 0; k < r->t->row_lanes; k++) sum += r->lane[at + (size_t)k];
        out[i] += sum;
    }
}

static void give_block(const giver *r, const sum_place *p, sum_block b, int pitch, float *out) {
    r->t->add(r->t, r->lane, p, &b, pitch, out);
}

/* A whole layer; b may be NULL. */
static void give_layer(const giver *r, const sum_place *p, const float *w, const float *b) {
    give_block(r, p, (sum_block){0, p->rows, 0, p->columns, 1}, p->columns, to(r, w));
    if (b) give_rows(r, p->b, p->rows, to(r, b));
}

static void give_fusion(const giver *r) {
    const radiance_trainer *t = r->t;
    const radiance_weights *w = r->w;
    const int width = t->n->s.token_width, all = t->n->attention_width;
    give_block(r, &t->sum.qkv, (sum_block){0, all, 0, width, t->q_scale}, width, to(r, w->qkv_w));
    give_block(r, &t->sum.qkv, (sum_block){all, 2 * all, 0, width, 1}, width,
               to(r, w->qkv_w) + (size_t)all * (size_t)width);
    give_layer(r, &t->sum.attention_out, w->attention_out_w, w->attention_out_b);
    give_layer(r, &t->sum.mlp0, w->mlp0_w, w->mlp0_b);
    give_layer(r, &t->sum.mlp1, w->mlp1_w, w->mlp1_b);
    give_rows(r, t->norm0_w, width, to(r, w->norm0_w));
    give_rows(r, t->norm0_b, width, to(r, w->norm0_b));
    give_rows(r, t->norm1_w, width, to(r, w->norm1_w));
    give_rows(r, t->norm1_b, width, to(r, w->norm1_b));
}

/* The tokens' biases: token i has b + W_v b_volume[i]; d [3 D]. */
static void give_token_biases(const giver *r, const float *d) {
    const radiance_weights *w = r->w;
    const int width = r->t->n->s.token_width, fused = r->t->n->fused;
    float *dw = to(r, w->token_projection_w), *db = to(r, w->token_projection_b),
          *dv = to(r, w->volume_projection_b);
    for (int k = 0; k < fused; k++) {
        const size_t row = (size_t)(k % width) * (size_t)fused + 2 * (size_t)width;
        db[k % width] += d[k];
        for (int j = 0; j < width; j++) {
            dw[row + (size_t)j] += d[k] * w->volume_projection_b[k / width * width + j];
            dv[k / width * width + j] += d[k] * w->token_projection_w[row + (size_t)j];
        }
    }
}

/* Colour's columns of the token projection, a token's at a time, and the biases. */
static sherf_status give_tokens(context *c, const giver *r) {
    const radiance_field *n = r->t->n;
    const int width = n->s.token_width, f = n->s.feature_channels;
    for (int q = 0, count; q < n->color_width; q += count) {
        const int token = (f + q) / width, left = n->color_width - q;
        count = (token + 1) * width - f - q;
        count = count < left ? count : left;
        give_block(r, &r->t->sum.color, (sum_block){(token - n->color_token) * width, width, q, count, 1},
                   n->fused, to(r, r->w->token_projection_w) + width + (f + q) % width);
    }
    float *d = mem_zero(c, (size_t)n->fused, sizeof *d);
    if (!d) return SHERF_NO_MEMORY;
    give_rows(r, r->t->token_b, n->fused, d);
    give_token_biases(r, d);
    mem_free(d);
    return SHERF_OK;
}

/* The merged layer's first h columns, M = V F (views times feature), and its bias V b_F + b_V: dm
 * [view_width][h] and db [view_width] -> the gradients of V, F and b_F. */
static void give_merged(const giver *r, const float *dm, const float *db) {
    const radiance_field *n = r->t->n;
    const radiance_weights *w = r->w;
    const int h = n->s.decoder_width, columns = h + n->direction_width + n->s.token_width;
    float *dv = to(r, w->views_w), *df = to(r, w->feature_w), *dbf = to(r, w->feature_b);
    for (int o = 0; o < n->s.view_width; o++)
        for (int f = 0; f < h; f++) {
            const float v = w->views_w[(size_t)o * (size_t)columns + (size_t)f];
            const float *row = w->feature_w + (size_t)f * (size_t)h, *d = dm + (size_t)o * (size_t)h;
            float sum = 0;
            for (int k = 0; k < h; k++) sum += d[k] * row[k];
            for (int k = 0; k < h; k++) df[(size_t)f * (size_t)h + (size_t)k] += v * d[k];
            dv[(size_t)o * (size_t)columns + (size_t)f] += sum + db[o] * w->feature_b[f];
            dbf[f] += v * db[o];
        }
}

static sherf_status give_decoder(context *c, const giver *r) {
    const radiance_trainer *t = r->t;
    const radiance_weights *w = r->w;
    const sum_place *p = &t->sum.views;
    const int h = t->n->s.decoder_width, view = t->n->s.view_width, rest = p->columns - h;
    for (int i = 0; i < t->n->s.decoder_depth; i++) give_layer(r, &t->sum.pts[i], w->pts_w[i], w->pts_b[i]);
    give_block(r, p, (sum_block){t->alpha_row, 1, 0, h, 1}, h, to(r, w->alpha_w));
    give_rows(r, p->b + (size_t)(t->alpha_row * t->row_lanes), 1, to(r, w->alpha_b));
    float *dm = mem_zero(c, (size_t)view * ((size_t)h + 1), sizeof *dm);
    if (!dm) return SHERF_NO_MEMORY;
    float *db = dm + (size_t)view * (size_t)h;
    give_block(r, p, (sum_block){0, view, 0, h, 1}, h, dm);
    give_rows(r, p->b, view, db);
    give_merged(r, dm, db);
    mem_free(dm);
    give_rows(r, p->b, view, to(r, w->views_b));
    give_block(r, p, (sum_block){0, view, h, rest, 1}, h + rest, to(r, w->views_w) + h);
    give_layer(r, &t->sum.rgb, w->rgb_w, w->rgb_b);
    return SHERF_OK;
}

sherf_status radiance_sums_give(context *c, const radiance_trainer *t, const float *lane,
                                const radiance_weights *w, const radiance_gradients *g) {
    const giver r = {t, lane, w, g};
    give_fusion(&r);
    sherf_status status = give_tokens(c, &r);
    return status ? status : give_decoder(c, &r);
}

/* ---- the transposed layers ---- */
sherf_status radiance_views_and_alpha(context *c, const radiance_matrices *m, int alpha_row,
                                      radiance_matrix *out) {
    const size_t h = (size_t)m->alpha.columns;
    *out = (radiance_matrix){.rows = alpha_row + 1, .columns = (int)h};
    out->w = mem_zero(c, (size_t)out->rows * h, sizeof(float));
    if (!out->w) return SHERF_NO_MEMORY;
    for (int r = 0; r < m->views.rows; r++)
        memcpy(out->w + (size_t)r * h, m->views.w + (size_t)r * (size_t)m->views.columns, h * sizeof(float));
    memcpy(out->w + (size_t)alpha_row * h, m->alpha.w, h * sizeof(float));
    return SHERF_OK;
}
