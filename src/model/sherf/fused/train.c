/* The backward pass of the radiance field: finds the points with a gradient and loops over their tiles. */
#include "model/sherf/fused/train.h"

#include <stdatomic.h>
#include <string.h>

#include "model/sherf/fused/train_inside.h"

/* Points are split over this many lanes, each with its own sums, for any number of threads, so that results
 * do not depend on it. */
enum { LANES = 16 };

bool radiance_training_possible(const radiance_sizes *s, bool bf16) {
#if defined(__x86_64__)
    if (bf16) return radiance_training_amx_fits(s);
#endif
    return !bf16 && radiance_training_float_fits(s);
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
    size_t part;   /* bytes */
    const radiance_gradients *out;
    atomic_int next_scatter; /* the next job that no thread has taken */
} back_work;

/* Fills in the tile's points from the first on, and their gradients; colour's through its sigmoid (y = 1.002
 * s - 0.001). */
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
    char *scratch = w->scratch + (size_t)thread * w->part;
    train_tile tile;
    for (int64_t lane = begin; lane < end; lane++) {
        float *sums = w->lane + (size_t)lane * t->lane_floats;
        memset(sums, 0, t->lane_floats * sizeof *sums);
        for (int64_t i = w->tiles * lane / LANES; i < w->tiles * (lane + 1) / LANES; i++) {
            if (cancelled(w->c)) return;
            fill(w, i * TRAIN_POINTS, &tile);
            t->tile(t, &tile, sums, scratch);
        }
    }
}

/* Jobs differ in length, and each writes its own part of the gradients, so any thread may take any job. */
static void scatter_range(void *arg, int64_t begin, int64_t end, int thread) {
    back_work *w = arg;
    for (int job; (job = atomic_fetch_add(&w->next_scatter, 1)) < w->t->scatter_jobs;)
        w->t->scatter(w->t->n, job, w->points, w->index, w->count, w->dtoken, w->out);
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

/* ---- all of it ---- */
static sherf_status trainer_make(context *c, const radiance_field *n, const radiance_weights *weights,
                                 radiance_trainer **out) {
    radiance_matrices m = {0};
    sherf_status status = radiance_matrices_make(c, n, weights, &m);
#if defined(__x86_64__)
    if (!status && n->bf16) status = radiance_trainer_amx(c, n, &m, out);
#endif
    if (!status && !n->bf16) status = radiance_trainer_float(c, n, &m, out);
    radiance_matrices_free(&m);
    return status;
}

static sherf_status go_back(tape *work, back_work *w) {
    context *c = w->c;
    const radiance_trainer *t = w->t;
    w->tiles = (w->count + TRAIN_POINTS - 1) / TRAIN_POINTS;
    w->part = (t->scratch_bytes + 4095) / 4096 * 4096;
    w->lane = tape_alloc(work, LANES * t->lane_floats, sizeof(float));
    w->dtoken = tape_alloc(work, (size_t)w->count + 1, (size_t)t->n->fused * sizeof(float));
    w->scratch = tape_alloc(work, (size_t)c->threads, w->part);
    if (tape_status(work) != SHERF_OK) return tape_status(work);
    memset(w->scratch, 0, (size_t)c->threads * w->part);
    parallel_for(c, LANES, 1, lanes_range, w);
    if (cancelled(c)) return failure(c, SHERF_CANCELLED, "cancelled");
    parallel_for(c, c->threads, 1, scatter_range, w);
    parallel_for(c, (int64_t)t->lane_floats, 4096, sum_range, w);
    return SHERF_OK;
}

sherf_status radiance_field_backward(tape *work, const radiance_field *n, const radiance_weights *weights,
                                     const point_set *points, const float *rgb, const float *drgb,
                                     const float *dsigma, const radiance_gradients *out) {
    context *c = tape_context(work);
    if (!radiance_training_possible(&n->s, n->bf16))
        return failure(c, SHERF_UNSUPPORTED,
                       "radiance field: no fused gradient for these sizes or this processor");
    if (points->count > INT32_MAX / 4)
        return failure(c, SHERF_BAD_ARGUMENT, "radiance field: %lld points are too many",
                       (long long)points->count);
    radiance_trainer *t = NULL;
    int32_t *index = tape_alloc(work, (size_t)points->count + 1, sizeof *index);
    sherf_status status = index ? trainer_make(c, n, weights, &t) : SHERF_NO_MEMORY;
    if (status) return status;
    back_work w = {c, t, points, rgb, drgb, dsigma, .index = index, .out = out};
    w.count = list_points(points, drgb, dsigma, index);
    status = go_back(work, &w);
    if (!status) status = radiance_sums_give(c, t, w.lane, weights, out);
    t->release(t);
    return status;
}
