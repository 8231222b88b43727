/* graph_kernels: plain loops over rows; convolutions take nearly all of a network's time. */
#include <math.h>
#include <string.h>

#include "nn/graph_kernels.h"

enum { GRAIN = 1 << 14 };

typedef struct {
    graph_activation then;
    const float *a, *b;
    float *y;
} sum_work;

static void sum_range(void *arg, int64_t begin, int64_t end, int thread) {
    const sum_work *w = arg;
    const float *a = w->a, *b = w->b;
    float *y = w->y;
    const float low = w->then == GRAPH_LINEAR ? -INFINITY : 0, high = w->then == GRAPH_RELU6 ? 6 : INFINITY;
    for (int64_t i = begin; i < end; i++) {
        float v = b ? a[i] + b[i] : a[i];
        v = v > low ? v : low;
        y[i] = v < high ? v : high;
    }
}

static void sigmoid_range(void *arg, int64_t begin, int64_t end, int thread) {
    const sum_work *w = arg;
    for (int64_t i = begin; i < end; i++) {
        const float v = w->b ? w->a[i] + w->b[i] : w->a[i];
        w->y[i] = 1 / (1 + expf(-v));
    }
}

void graph_sum(const context *c, int64_t count, graph_activation then, const float *a, const float *b,
               float *y) {
    sum_work w = {then, a, b, y};
    parallel_for(c, count, GRAIN, then == GRAPH_SIGMOID ? sigmoid_range : sum_range, &w);
}

static int64_t rows_of(int64_t values_per_row) {
    return values_per_row < GRAIN ? GRAIN / (values_per_row + 1) + 1 : 1;
}

typedef struct {
    const graph_pool *p;
    const float *x;
    float *y;
} pool_work;

static void pool_pixel(const graph_pool *p, const float *x, int64_t row, int64_t column, float *y) {
    const int64_t top = row * p->stride[0] - p->before[0], left = column * p->stride[1] - p->before[1];
    for (int64_t k = 0; k < p->channels; k++) y[k] = -INFINITY;
    for (int64_t i = top < 0 ? 0 : top; i < top + p->kernel[0] && i < p->in[0]; i++)
        for (int64_t j = left < 0 ? 0 : left; j < left + p->kernel[1] && j < p->in[1]; j++) {
            const float *from = x + (i * p->in[1] + j) * p->channels;
            for (int64_t k = 0; k < p->channels; k++) y[k] = from[k] > y[k] ? from[k] : y[k];
        }
}

static void pool_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const pool_work *w = arg;
    const graph_pool *p = w->p;
    for (int64_t row = begin; row < end; row++)
        for (int64_t column = 0; column < p->out[1]; column++)
            pool_pixel(p, w->x, row, column, w->y + (row * p->out[1] + column) * p->channels);
}

void graph_max_pool(const context *c, const graph_pool *p, const float *x, float *y) {
    pool_work w = {p, x, y};
    parallel_for(c, p->out[0], rows_of(p->out[1] * p->channels), pool_rows, &w);
}

typedef struct {
    const graph_scaling *s;
    const float *x;
    float *y;
} resize_work;

/* The two pixels of x around pixel `to` of y. Returns the distance from the first one, 0 to 1. */
static float neighbours(const graph_scaling *s, int axis, int64_t to, int64_t *first, int64_t *second) {
    const int64_t in = s->in[axis], out = s->out[axis];
    const float ratio = s->corners && out > 1 ? (float)(in - 1) / (float)(out - 1) : (float)in / (float)out;
    const float at = s->half_pixel ? ((float)to + .5f) * ratio - .5f : (float)to * ratio;
    const float down = floorf(at > 0 ? at : 0);
    *first = (int64_t)down < in - 1 ? (int64_t)down : in - 1;
    *second = *first + 1 < in ? *first + 1 : *first;
    return at > 0 ? at - down : 0;
}

static void resize_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const resize_work *w = arg;
    const graph_scaling *s = w->s;
    const int64_t n = s->channels;
    for (int64_t row = begin; row < end; row++) {
        int64_t i0, i1, j0, j1;
        const float down = neighbours(s, 0, row, &i0, &i1);
        for (int64_t column = 0; column < s->out[1]; column++) {
            const float across = neighbours(s, 1, column, &j0, &j1);
            const float *a = w->x + (i0 * s->in[1] + j0) * n, *b = w->x + (i0 * s->in[1] + j1) * n,
                        *c = w->x + (i1 * s->in[1] + j0) * n, *d = w->x + (i1 * s->in[1] + j1) * n;
            float *y = w->y + (row * s->out[1] + column) * n;
            for (int64_t k = 0; k < n; k++) {
                const float above = a[k] + (b[k] - a[k]) * across, below = c[k] + (d[k] - c[k]) * across;
                y[k] = above + (below - above) * down;
            }
        }
    }
}

void graph_resize(const context *c, const graph_scaling *s, const float *x, float *y) {
    resize_work w = {s, x, y};
    parallel_for(c, s->out[0], rows_of(s->out[1] * s->channels), resize_rows, &w);
}

void graph_unfold(const context *c, int64_t height, int64_t width, int64_t channels, int64_t block,
                  const float *x, float *y) {
    for (int64_t row = 0; row < height; row++)
        for (int64_t column = 0; column < width; column++)
            for (int64_t i = 0; i < block; i++) {
                /* a row of the block: its pixels are contiguous in both */
                const float *from = x + ((row * width + column) * block * block + i * block) * channels;
                memcpy(y + ((row * block + i) * width + column) * block * channels, from,
                       (size_t)(block * channels) * sizeof *y);
            }
}

void graph_pad(const int64_t in[3], const int64_t out[3], const int64_t before[3], const float *x, float *y) {
    memset(y, 0, (size_t)(out[0] * out[1] * out[2]) * sizeof *y);
    for (int64_t row = 0; row < in[0]; row++)
        for (int64_t column = 0; column < in[1]; column++)
            memcpy(y + ((row + before[0]) * out[1] + column + before[1]) * out[2] + before[2],
                   x + (row * in[1] + column) * in[2], (size_t)in[2] * sizeof *y);
}
