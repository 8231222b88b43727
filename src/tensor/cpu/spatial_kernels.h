/* The interface between the spatial ops' drivers (spatial_sample.c etc.) and their inner loops, which are
 * compiled once for each instruction set (spatial_plain.c, spatial_neon.c etc. from spatial_*.inc). Every
 * inner loop is a range_function for parallel_for; its argument is one of the structs below. No result
 * depends on how a range was split: one thread computes each element, or sums it in a fixed order. */
#ifndef SHERF_SPATIAL_KERNELS_H
#define SHERF_SPATIAL_KERNELS_H

#include "tensor/cpu/cpu.h"

/* Bilinear: ranges of points. Backward: ranges of parts, part p owns the map rows [bound[p], bound[p + 1]).
 */
typedef struct {
    int64_t height, width, channels, points;
    const float *map, *position, *dy;
    float *y, *dmap;
    const int64_t *bound;
} bilinear_work;

/* Trilinear: ranges of points. `corners`: fills row and weight, eight a point. Backward: part p owns the rows
 * [bound[p], bound[p + 1]) of dx. */
typedef struct {
    int64_t size[3], channels, points; /* size of x, y, z */
    const float *x, *position, *dy;
    const int32_t *grid;
    float *y, *dx;
    int32_t *row; /* [P, 8], -1: none */
    float *weight;
    const int64_t *bound;
} trilinear_work;

/* Sparse products; inputs and outputs are multiples of SPARSE_PANEL (the driver pads).
 * `rows`: y[a] += sum_k W_k x[rule[a, k]] for a range of a; weight [27, outputs / PANEL, inputs, PANEL].
 * `weights`: for a range of items (block of SPARSE_ROWS outputs, tap): dw[o, k, :] += sum over the tap's
 * pairs of dy[a, o] x[r, :]. */
enum { SPARSE_PANEL = 32, SPARSE_ROWS = 8, SPARSE_TAPS = 27, SPARSE_BLOCK = 256 };
typedef struct {
    int32_t to, from;
} sparse_pair;
typedef struct {
    int64_t inputs, outputs;
    const float *x, *weight, *dy;
    const int32_t *rule;
    float *y, *dw;
    const sparse_pair *pair; /* by tap */
    const int64_t *pairs;    /* [28] where each tap's pairs begin */
} sparse_work;

/* Ranges of rows; backward: of parts of `part` rows, each with its own sums [parts, 2, C] of dweight, dbias.
 */
typedef struct {
    int64_t rows, columns, part;
    const float *x, *weight, *bias, *dy;
    float *y, *dx, *sums;
} norm_work;

/* Ranges of points: 3 tokens, up to 4 heads of 16. */
typedef struct {
    int heads;
    float scale;
    const float *qkv, *dy;
    float *y, *dqkv;
} attention_work;

/* Ranges of elements. */
typedef struct {
    const float *x, *dy;
    float *y, *dx, gain, offset;
} map_work;

/* Ranges of points. |x| 2^(frequencies - 1) < 8000. */
typedef struct {
    int64_t columns, width;
    int frequencies;
    const float *x;
    float *y;
} encode_work;

/* Ranges of rays. scratch: [threads, 3, longest], longest a multiple of 16. */
typedef struct {
    composite_attr attr;
    const float *sigma, *rgb, *near, *far, *length, *at /* or NULL */, *dy;
    const int32_t *first, *sample;
    float *y, *dsigma, *drgb, *scratch;
    int64_t longest;
} composite_work;

/* `statistics`: for a range of window rows: sum[row] and, when by is not NULL, by[3][rows][columns]
 * (derivatives by the means of x, x^2, x y). `gradient`: for a range of image rows. row floats = width *
 * channels. scratch: [threads, 5, row + 20 channels]. */
typedef struct {
    int64_t height, row, channels;
    const float *x, *y;
    float *by, *scratch, *dx, scale;
    double *sum;
    float window[11];
} ssim_work;

/* Ranges of parts of `part` rows, one sum each. */
typedef struct {
    int64_t rows, columns, part;
    const float *a, *b, *head;
    const int32_t *mask;
    float *da, scale;
    double *sum;
    int64_t *count;
} loss_work;

typedef struct {
    range_function bilinear, bilinear_back, trilinear, trilinear_corners, trilinear_back, sparse_rows,
        sparse_weights, norm, norm_back, attention, attention_back, gelu, gelu_back, sigmoid, sigmoid_back,
        encode, composite, composite_back, ssim_statistics, ssim_gradient, square, square_back, distance,
        distance_back;
} spatial_table;
extern const spatial_table spatial_plain, spatial_neon, spatial_avx2, spatial_avx512;
const spatial_table *spatial_best(void);

/* The data of the call's tensors; NULL for missing ones. */
static inline float *input(const op_call *call, int i) {
    return call->in[i] ? call->in[i]->data : NULL;
}
static inline float *input_gradient(const op_call *call, int i) {
    return call->din[i] ? call->din[i]->data : NULL;
}
#endif
