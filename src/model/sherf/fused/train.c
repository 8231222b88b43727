/* Preparation of the backward pass, its loop over tiles, and what becomes of the sums: gradients of the
 * weights as the checkpoints have them. */
#include "model/sherf/fused/train.h"

#include <math.h>
#include <string.h>

#if defined(__x86_64__)
#include "model/sherf/fused/train_inside.h"

/* Points are split over this many lanes, each with sums of its own, whatever the number of threads, so that
 * results do not depend on it. */
enum { LANES = 16 };

bool radiance_training_possible(const radiance_sizes *s) {
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

static sherf_status pack_all_back(context *c, radiance_matrices *m, radiance_trainer *t) {
    const radiance_field *n = t->n;
    const radiance_amx *a = n->amx;
    const int h = n->s.decoder_width, x = n->position_width, skip = n->s.decoder_skip,
              h_tiles = 2 * a->h_blocks, all = n->attention_width;
    sherf_status s = pack_back(c, &m->rgb, 0, n->s.view_width, 2 * t->view_blocks, 1, &t->back_rgb);
    if (!s) s = pack_back_views(c, m, h, t->view_blocks, h_tiles, &t->back_views);
    if (!s) s = pack_back(c, &m->views, h + n->direction_width, WIDTH, 2, t->view_blocks, &t->back_token1);
    for (int i = 1; i < n->s.decoder_depth && !s; i++)
        s = pack_back(c, &m->pts[i], i == skip + 1 ? x + WIDTH : 0, h, h_tiles, a->h_blocks, &t->back_pts[i]);
    if (!s && skip >= 0) s = pack_back(c, &m->pts[skip + 1], x, WIDTH, 2, a->h_blocks, &t->back_skip_token0);
    if (!s) s = pack_back(c, &m->pts[0], x, WIDTH, 2, a->h_blocks, &t->back_token0);
    if (!s) s = pack_back(c, &m->mlp1, 0, WIDTH, 2, 1, &t->back_mlp1);
    if (!s) s = pack_back(c, &m->mlp0, 0, WIDTH, 2, 1, &t->back_mlp0);
    if (!s) s = pack_back(c, &m->attention_out, 0, all, all / 16, 1, &t->back_out);
    for (int i = 0; i < all * WIDTH; i++)
        m->qkv.w[i] *= radiance_q_scale(n); /* as the forward pass has them */
    if (!s) s = pack_back(c, &m->qkv, 0, WIDTH, 2, t->qkv_blocks, &t->back_qkv);
    return s;
}

/* ---- where sums go ---- */
static size_t place_rows(radiance_trainer *t, int rows) {
    size_t at = t->lane_floats;
    t->lane_floats += (size_t)rows * 16;
    return at;
}

static matrix_place place(radiance_trainer *t, int row_blocks, int column_blocks) {
    matrix_place p = {.row_tiles = 2 * row_blocks, .column_tiles = 2 * column_blocks};
    p.w = t->lane_floats;
    t->lane_floats += (size_t)p.row_tiles * (size_t)p.column_tiles * 256;
    p.b = place_rows(t, row_blocks * 32);
    return p;
}

static void place_all(radiance_trainer *t) {
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

static void trainer_free(radiance_trainer *t) {
    tiles *all[] = {&t->back_rgb,  &t->back_views, &t->back_token1, &t->back_skip_token0, &t->back_token0,
                    &t->back_mlp1, &t->back_mlp0,  &t->back_out,    &t->back_qkv};
    for (size_t i = 0; i < COUNT_OF(all); i++) tiles_free(all[i]);
    for (int i = 0; i < POINT_DECODER_MAX; i++) tiles_free(&t->back_pts[i]);
}

static sherf_status trainer_make(context *c, const radiance_field *n, radiance_matrices *m,
                                 radiance_trainer *t) {
    *t = (radiance_trainer){.n = n,
                            .view_blocks = (n->s.view_width + 31) / 32,
                            .qkv_blocks = (3 * n->attention_width + 31) / 32,
                            .color_tokens = n->color_width ? 3 - n->color_token : 0};
    place_all(t);
    sherf_status status = pack_all_back(c, m, t);
    t->scratch_bytes = (radiance_train_scratch_bytes(t) + 4095) / 4096 * 4096;
    return status;
}

/* ---- the points with a gradient ---- */
typedef struct {
    context *c;
    const radiance_trainer *t;
    const point_set *points;
    const float *rgb, *drgb, *dsigma;
    const int32_t *index; /* of the points with a gradient */
    int64_t count, tiles;
    float *lane;   /* LANES x lane_floats */
    float *dtoken; /* [count][3 D] */
    char *scratch; /* one part a thread */
    const radiance_gradients *out;
} back_work;

/* The tile's points from the first on, and their gradients; colour's through its sigmoid (y = 1.002 s -
 * 0.001). */
static void fill(const back_work *w, int64_t first, train_tile *t) {
    int64_t left = w->count - first;
    t->count = left < TRAIN_POINTS ? (int)left : TRAIN_POINTS;
    t->dtoken = w->dtoken + first * w->t->n->fused;
    memset(t->dout, 0, sizeof t->dout);
    for (int part = 0; part < TRAIN_PARTS; part++) {
        int64_t index[POINT_TILE];
        int count = t->count - part * POINT_TILE;
        count = count < 0 ? 0 : count > POINT_TILE ? POINT_TILE : count;
        for (int p = 0; p < count; p++) index[p] = w->index[first + part * POINT_TILE + p];
        point_tile_fill(w->points, index, 0, count, &t->part[part]);
        for (int p = 0; p < count; p++) {
            for (int k = 0; k < 3; k++) {
                float s = (w->rgb[3 * index[p] + k] + 0.001f) / 1.002f;
                t->dout[k][part * POINT_TILE + p] = w->drgb[3 * index[p] + k] * 1.002f * s * (1 - s);
            }
            t->dout[3][part * POINT_TILE + p] = w->dsigma[index[p]];
        }
    }
}

static void lanes_range(void *arg, int64_t begin, int64_t end, int thread) {
    const back_work *w = arg;
    const radiance_trainer *t = w->t;
    char *scratch = w->scratch + (size_t)thread * t->scratch_bytes;
    train_tile tile;
    for (int64_t lane = begin; lane < end; lane++) {
        float *sums = w->lane + (size_t)lane * t->lane_floats;
        memset(sums, 0, t->lane_floats * sizeof *sums);
        for (int64_t i = w->tiles * lane / LANES; i < w->tiles * (lane + 1) / LANES; i++) {
            if (cancelled(w->c)) return;
            fill(w, i * TRAIN_POINTS, &tile);
            radiance_train_tile_amx(t, &tile, sums, scratch);
        }
    }
}

static void scatter_range(void *arg, int64_t begin, int64_t end, int thread) {
    const back_work *w = arg;
    for (int64_t job = begin; job < end; job++)
        radiance_scatter_amx(w->t->n, (int)job, w->points, w->index, w->count, w->dtoken, w->out);
}

static void sum_range(void *arg, int64_t begin, int64_t end, int thread) {
    const back_work *w = arg;
    for (int lane = 1; lane < LANES; lane++) {
        const float *from = w->lane + (size_t)lane * w->t->lane_floats;
        for (int64_t i = begin; i < end; i++) w->lane[i] += from[i];
    }
}

static int64_t list_points(const point_set *points, const float *drgb, const float *dsigma, int32_t *index) {
    int64_t count = 0;
    for (int64_t i = 0; i < points->count; i++) {
        const float *d = drgb + 3 * i;
        index[count] = (int32_t)i;
        count += d[0] != 0 || d[1] != 0 || d[2] != 0 || dsigma[i] != 0;
    }
    return count;
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

static void unpack_fusion(const radiance_trainer *t, const float *lane, const radiance_weights *w,
                          const radiance_gradients *g, int *slot) {
    const radiance_field *n = t->n;
    const int all = n->attention_width;
#define GRAD(p) (g->grads + ((p)-g->values))
    slots_none(slot);
    slots_add(slot, 0, 0, WIDTH);
    unpack(lane, &t->qkv, 0, all, WIDTH, slot, radiance_q_scale(n), GRAD(w->qkv_w));
    unpack(lane, &t->qkv, all, 2 * all, WIDTH, slot, 1, GRAD(w->qkv_w) + (size_t)all * WIDTH);
    unpack(lane, &t->mlp0, 0, WIDTH, WIDTH, slot, 1, GRAD(w->mlp0_w));
    unpack(lane, &t->mlp1, 0, WIDTH, WIDTH, slot, 1, GRAD(w->mlp1_w));
    slots_add(slot, 0, 0, all);
    unpack(lane, &t->attention_out, 0, WIDTH, all, slot, 1, GRAD(w->attention_out_w));
    add_rows(lane, t->attention_out.b, WIDTH, GRAD(w->attention_out_b));
    add_rows(lane, t->mlp0.b, WIDTH, GRAD(w->mlp0_b));
    add_rows(lane, t->mlp1.b, WIDTH, GRAD(w->mlp1_b));
    add_rows(lane, t->norm0_w, WIDTH, GRAD(w->norm0_w));
    add_rows(lane, t->norm0_b, WIDTH, GRAD(w->norm0_b));
    add_rows(lane, t->norm1_w, WIDTH, GRAD(w->norm1_w));
    add_rows(lane, t->norm1_b, WIDTH, GRAD(w->norm1_b));
}

/* Colour's columns of the token projection, and the biases: token i has b + W_v b_volume[i]. */
static void unpack_tokens(const radiance_trainer *t, const float *lane, const radiance_weights *w,
                          const radiance_gradients *g, int *slot) {
    const radiance_field *n = t->n;
    const int f = n->s.feature_channels;
    float *dw = GRAD(w->token_projection_w), *db = GRAD(w->token_projection_b),
          *dv = GRAD(w->volume_projection_b);
    for (int i = 0; i < t->color_tokens; i++) {
        slots_none(slot);
        for (int q = 0; q < n->color_width; q++)
            if ((f + q) / WIDTH - n->color_token == i) slot[q] = WIDTH + (f + q) % WIDTH;
        unpack(lane, &t->color, i * WIDTH, WIDTH, n->fused, slot, 1, dw);
    }
    for (int r = 0; r < n->fused; r++) {
        const float d = row_sum(lane, t->token_b + (size_t)r * 16);
        const size_t row = (size_t)(r % WIDTH) * (size_t)n->fused + 2 * WIDTH;
        db[r % WIDTH] += d;
        for (int j = 0; j < WIDTH; j++) {
            dw[row + (size_t)j] += d * w->volume_projection_b[r / WIDTH * WIDTH + j];
            dv[r / WIDTH * WIDTH + j] += d * w->token_projection_w[row + (size_t)j];
        }
    }
}

/* The merged layer M = V F (views' first h columns times feature), bias V b_F + b_V. dm [view_width][h], db.
 */
static void unmerge(const radiance_field *n, const radiance_weights *w, const radiance_gradients *g,
                    const float *dm, const float *db) {
    const int h = n->s.decoder_width, columns = h + n->direction_width + n->s.token_width;
    float *dv = GRAD(w->views_w), *df = GRAD(w->feature_w), *dbf = GRAD(w->feature_b);
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

static sherf_status unpack_decoder(context *c, const radiance_trainer *t, const float *lane,
                                   const radiance_weights *w, const radiance_gradients *g, int *slot) {
    const radiance_field *n = t->n;
    const radiance_amx *a = n->amx;
    const int h = n->s.decoder_width, x = n->position_width + WIDTH, view = n->s.view_width;
    for (int i = 0; i < n->s.decoder_depth; i++) {
        const bool first = i == 0, wide = !first && i == n->s.decoder_skip + 1;
        slots_none(slot);
        if (first || wide) slots_add_encoded(slot, 0, 0, n->position_width);
        if (!first) slots_add(slot, wide ? a->x_blocks * 32 : 0, wide ? x : 0, h);
        unpack(lane, &t->pts[i], 0, h, first ? x : wide ? x + h : h, slot, 1, GRAD(w->pts_w[i]));
        add_rows(lane, t->pts[i].b, h, GRAD(w->pts_b[i]));
    }
    slots_none(slot);
    slots_add(slot, 0, 0, h);
    unpack(lane, &t->views, 32 * t->view_blocks, 1, h, slot, 1, GRAD(w->alpha_w));
    add_rows(lane, t->views.b + (size_t)t->view_blocks * 512, 1, GRAD(w->alpha_b));
    float *dm = mem_zero(c, (size_t)view * ((size_t)h + 1), sizeof *dm);
    if (!dm) return SHERF_NO_MEMORY;
    float *db = dm + (size_t)view * (size_t)h;
    unpack(lane, &t->views, 0, view, h, slot, 1, dm);
    add_rows(lane, t->views.b, view, db);
    unmerge(n, w, g, dm, db);
    add_rows(lane, t->views.b, view, GRAD(w->views_b));
    mem_free(dm);
    slots_none(slot);
    slots_add_encoded(slot, a->h_blocks * 32, h, n->direction_width);
    unpack(lane, &t->views, 0, view, h + n->direction_width + WIDTH, slot, 1, GRAD(w->views_w));
    slots_none(slot);
    slots_add(slot, 0, 0, view);
    unpack(lane, &t->rgb, 0, 3, view, slot, 1, GRAD(w->rgb_w));
    add_rows(lane, t->rgb.b, 3, GRAD(w->rgb_b));
    return SHERF_OK;
#undef GRAD
}

sherf_status radiance_field_backward(tape *work, const radiance_field *n, const radiance_weights *weights,
                                     const point_set *points, const float *rgb, const float *drgb,
                                     const float *dsigma, const radiance_gradients *out) {
    context *c = tape_context(work);
    if (!n->bf16 || !radiance_training_possible(&n->s))
        return failure(c, SHERF_UNSUPPORTED,
                       "radiance field: no fused gradient for these sizes or this processor");
    if (points->count > INT32_MAX / 4)
        return failure(c, SHERF_BAD_ARGUMENT, "radiance field: %lld points are too many",
                       (long long)points->count);
    radiance_matrices m = {0};
    radiance_trainer t = {0};
    int *slot = tape_alloc(work, SLOTS, sizeof *slot);
    int32_t *index = tape_alloc(work, (size_t)points->count + 1, sizeof *index);
    sherf_status status = index ? radiance_matrices_make(c, n, weights, &m) : SHERF_NO_MEMORY;
    if (!status) status = trainer_make(c, n, &m, &t);
    if (status) goto done;
    back_work w = {c, &t, points, rgb, drgb, dsigma, .index = index, .out = out};
    w.count = list_points(points, drgb, dsigma, index);
    w.tiles = (w.count + TRAIN_POINTS - 1) / TRAIN_POINTS;
    w.lane = tape_alloc(work, LANES * t.lane_floats, sizeof(float));
    w.dtoken = tape_alloc(work, (size_t)w.count + 1, (size_t)n->fused * sizeof(float));
    w.scratch = tape_alloc(work, (size_t)c->threads, t.scratch_bytes);
    if ((status = tape_status(work)) != SHERF_OK) goto done;
    memset(w.scratch, 0, (size_t)c->threads * t.scratch_bytes);
    parallel_for(c, LANES, 1, lanes_range, &w);
    if (cancelled(c)) {
        status = failure(c, SHERF_CANCELLED, "cancelled");
        goto done;
    }
    parallel_for(c, POINT_SCATTER_JOBS, 1, scatter_range, &w);
    parallel_for(c, (int64_t)t.lane_floats, 4096, sum_range, &w);
    unpack_fusion(&t, w.lane, weights, out, slot);
    unpack_tokens(&t, w.lane, weights, out, slot);
    status = unpack_decoder(c, &t, w.lane, weights, out, slot);
done:
    trainer_free(&t);
    radiance_matrices_free(&m);
    return status;
}
#else
bool radiance_training_possible(const radiance_sizes *s) {
    return false;
}

sherf_status radiance_field_backward(tape *work, const radiance_field *n, const radiance_weights *weights,
                                     const point_set *points, const float *rgb, const float *drgb,
                                     const float *dsigma, const radiance_gradients *out) {
    return failure(tape_context(work), SHERF_UNSUPPORTED,
                   "radiance field: no fused gradient for this processor");
}
#endif
