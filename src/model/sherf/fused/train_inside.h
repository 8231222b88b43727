/* The inside of training: what the ways of arithmetic share. */
#ifndef SHERF_RADIANCE_TRAIN_INSIDE_H
#define SHERF_RADIANCE_TRAIN_INSIDE_H

#include "model/sherf/fused/inside.h"
#include "model/sherf/fused/train.h"

/* Points of a tile of the backward pass. */
enum { TRAIN_POINTS = 128, TRAIN_PARTS = TRAIN_POINTS / POINT_TILE };

typedef struct {
    point_tile part[TRAIN_PARTS];
    _Alignas(64) float dout[4][TRAIN_POINTS]; /* of the colour before the sigmoid, and of the density; 0
                                                 behind count */
    int count;
    float *dtoken; /* [count][3 D]: the gradient of what was sampled, out */
} train_tile;

/* The layers' transposed weights, from the gradient of a result to that of inputs; views: with alpha; token0,
 * skip_token0, token1: to the tokens that the first layer, the one behind the skip and the view layer read.
 * The decoder's are an array `pts`, too. LAYER(with, name) */
#define RADIANCE_BACK_LAYERS(LAYER, with)                                                                    \
    LAYER(with, rgb)                                                                                         \
    LAYER(with, views)                                                                                       \
    LAYER(with, token1)                                                                                      \
    LAYER(with, skip_token0)                                                                                 \
    LAYER(with, token0) LAYER(with, mlp1) LAYER(with, mlp0) LAYER(with, attention_out) LAYER(with, qkv)
#define RADIANCE_BACK_MEMBERS(type) RADIANCE_BACK_LAYERS(RADIANCE_MEMBER, type) type pts[POINT_DECODER_MAX];

/* One backward pass in one way of arithmetic. */
typedef struct radiance_trainer radiance_trainer;
struct radiance_trainer {
    const radiance_field *n;
    size_t lane_floats, scratch_bytes; /* of one lane's sums; of one thread, which starts as zeros */
    int scatter_jobs;
    void (*tile)(const radiance_trainer *r, train_tile *t, float *lane, void *scratch);
    /* One part of the bank: adds dtoken [count][3 D] of the points index[] to its gradient. */
    void (*scatter)(const radiance_field *n, int job, const point_set *points, const int32_t *index,
                    int64_t count, const float *dtoken, const radiance_gradients *out);
    /* A lane's sums are added to the weights' gradients. */
    sherf_status (*give)(context *c, const radiance_trainer *r, const float *lane, const radiance_weights *w,
                         const radiance_gradients *out);
    void (*release)(radiance_trainer *r);
};

/* Makes *out, to be released; m is used up. */
sherf_status radiance_trainer_float(context *c, const radiance_field *n, radiance_matrices *m,
                                    radiance_trainer **out); /* train_float.c */
sherf_status radiance_trainer_amx(context *c, const radiance_field *n, radiance_matrices *m,
                                  radiance_trainer **out); /* train_amx.c */
bool radiance_training_float_fits(const radiance_sizes *s);
bool radiance_training_amx_fits(const radiance_sizes *s);

/* Where the gradient of the weights at p goes. */
static inline float *radiance_gradient(const radiance_gradients *g, const float *p) {
    return g->grads + (p - g->values);
}

/* train.c: gradients through the algebra of radiance_matrices_make. */
/* The merged layer's first h columns, M = V F (views times feature), and its bias V b_F + b_V: dm
 * [view_width][h] and db [view_width] -> those of V, F and b_F. */
void radiance_give_views(const radiance_field *n, const radiance_weights *w, const radiance_gradients *g,
                         const float *dm, const float *db);
/* The tokens' biases: token i has b + W_v b_volume[i]; d [3 D]. */
void radiance_give_token_biases(const radiance_field *n, const radiance_weights *w,
                                const radiance_gradients *g, const float *d);

#endif
