/* graph_kernels: kernels of a graph's nodes other than convolutions. For nn/graph.c. */
#ifndef SHERF_GRAPH_KERNELS_H
#define SHERF_GRAPH_KERNELS_H

#include "nn/graph.h"

/* y = then(a + b), b NULL: then(a); y may be a. */
void graph_sum(const context *c, int64_t count, graph_activation then, const float *a, const float *b,
               float *y);
/* [in 0, in 1, channels] to [out 0, out 1, channels]; `before` pixels of padding precede the first. */
typedef struct {
    int64_t in[2], out[2], channels, kernel[2], stride[2], before[2];
} graph_pool;
void graph_max_pool(const context *c, const graph_pool *p, const float *x, float *y);
typedef struct {
    int64_t in[2], out[2], channels;
    bool half_pixel, corners;
} graph_scaling;
void graph_resize(const context *c, const graph_scaling *s, const float *x, float *y);
/* [height, width, block * block * channels] to [height * block, width * block, channels]. */
void graph_unfold(const context *c, int64_t height, int64_t width, int64_t channels, int64_t block,
                  const float *x, float *y);
/* [in] to [out], zeros around, `before` of them in front. */
void graph_pad(const int64_t in[3], const int64_t out[3], const int64_t before[3], const float *x, float *y);
#endif
