/* The inside of training, shared by float32 and bf16. */
#ifndef SHERF_RADIANCE_TRAIN_INSIDE_H
#define SHERF_RADIANCE_TRAIN_INSIDE_H

#include "model/sherf/fused/inside.h"
#include "model/sherf/fused/train.h"

/* Points of a tile of the backward pass. */
enum { TRAIN_POINTS = 128, TRAIN_PARTS = TRAIN_POINTS / POINT_TILE };

typedef struct {
    point_tile part[TRAIN_PARTS];
    _Alignas(64) float dout[4][TRAIN_POINTS]; /* gradients of the colour before the sigmoid and of the
                                                 density; 0 beyond count */
    int count;
    float *dtoken; /* [count][3 D], out: the gradient of the sampled values */
} train_tile;

/* The layers' transposed weights, from the gradient of a result to that of inputs: BACK(with, name, matrix,
 * first, count), whose inputs are `count` columns of a matrix from `first` on; matrices are `m` (and `both`:
 * views with alpha), the field is `n`. token0, skip_token0, token1: to the tokens that the first layer, the
 * layer after the skip and the view layer read. The decoder's others are an array `pts`. */
#define RADIANCE_BACK_LAYERS(BACK, with)                                                                     \
    BACK(with, rgb, &m->rgb, 0, m->rgb.columns)                                                              \
    BACK(with, views, &both, 0, n->s.decoder_width)                                                          \
    BACK(with, token1, &m->views, m->views.columns - n->s.token_width, n->s.token_width)                     \
    BACK(with, skip_token0, n->s.decoder_skip < 0 ? NULL : &m->pts[n->s.decoder_skip + 1],                   \
         n->position_width, n->s.token_width)                                                                \
    BACK(with, token0, &m->pts[0], n->position_width, n->s.token_width)                                      \
    BACK(with, mlp1, &m->mlp1, 0, m->mlp1.columns)                                                           \
    BACK(with, mlp0, &m->mlp0, 0, m->mlp0.columns)                                                           \
    BACK(with, attention_out, &m->attention_out, 0, m->attention_out.columns)                                \
    BACK(with, qkv, &m->qkv, 0, m->qkv.columns)
#define RADIANCE_BACK_MEMBER(type, name, ...) type name;
#define RADIANCE_BACK_MEMBERS(type)                                                                          \
    RADIANCE_BACK_LAYERS(RADIANCE_BACK_MEMBER, type) type pts[POINT_DECODER_MAX];
/* The first column of pts[i], i > 0, that reads the previous layer. */
static inline int radiance_hidden_column(const radiance_field *n, int i) {
    return i == n->s.decoder_skip + 1 ? n->position_width + n->s.token_width : 0;
}

/* A layer's gradient in a lane's memory, in floats: w as its way lays it out, b [outputs][row_lanes] of
 * partial sums.
 */
typedef struct {
    int rows, columns, padded_rows, padded_columns; /* actual sizes; whole blocks */
    size_t w, b;
} sum_place;
typedef struct {
    int first, rows, from, columns;
    float factor;
} sum_block;

/* One backward pass, in float32 or bf16. */
typedef struct radiance_trainer radiance_trainer;
struct radiance_trainer {
    const radiance_field *n;
    size_t lane_floats, scratch_bytes; /* of one lane's sums; of one thread, which starts as zeros */
    struct {
        RADIANCE_MEMBERS(sum_place) /* views: and alpha, which has none of its own */
    } sum;
    size_t norm0_w, norm0_b, norm1_w, norm1_b, token_b; /* rows of partial sums */
    int row_block, column_block;                        /* sums are padded to these */
    int row_lanes, alpha_row;                           /* partial sums a row; alpha's row in views' */
    float q_scale;                                      /* q's weights were packed times this */
    int scatter_jobs;
    void (*tile)(const radiance_trainer *r, train_tile *t, float *lane, void *scratch);
    /* One part of the bank: adds dtoken [count][3 D] of the points index[] to its gradient. */
    void (*scatter)(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                    int64_t count, const float *dtoken, const radiance_gradients *out);
    /* out [rows][pitch] += the block's rows and columns of the sums p, times its factor. */
    void (*add)(const radiance_trainer *r, const float *lane, const sum_place *p, const sum_block *b,
                int pitch, float *out);
    void (*release)(radiance_trainer *r);
};

/* Makes *out, to be released; overwrites m. */
sherf_status radiance_trainer_float(context *c, const radiance_field *n, radiance_matrices *m,
                                    radiance_trainer **out); /* train_float.c */
sherf_status radiance_trainer_amx(context *c, const radiance_field *n, radiance_matrices *m,
                                  radiance_trainer **out); /* train_amx.c */
bool radiance_training_float_fits(const radiance_sizes *s);
bool radiance_training_amx_fits(const radiance_sizes *s);

/* The address of the gradient of the weights at p. */
static inline float *radiance_gradient(const radiance_gradients *g, const float *p) {
    return g->grads + (p - g->values);
}

/* train_give.c */
/* Assigns every layer its place; keeps padded_columns that are set. */
void radiance_sums_place(radiance_trainer *t, const radiance_matrices *m);
/* Adds a lane's sums to the weights' gradients, back through the algebra of radiance_matrices_make. */
sherf_status radiance_sums_give(context *c, const radiance_trainer *t, const float *lane,
                                const radiance_weights *w, const radiance_gradients *g);
/* views' first h columns and, in row alpha_row, alpha's; b is NULL. Free w. */
sherf_status radiance_views_and_alpha(context *c, const radiance_matrices *m, int alpha_row,
                                      radiance_matrix *out);

#endif
