/* Bilinear and trilinear sampling. The backward passes scatter: every thread owns a range of destination
 * rows, visits all points and adds those that fall into its range. So sums run in the points' order for any
 * number of threads. The ranges have about the same number of contributions each. */
#include <string.h>

#include "tensor/cpu/spatial_kernels.h"

enum { GRAIN = 256, SAMPLED = 4096 }; /* points worth a thread; points sampled to balance the ranges */

const spatial_table *spatial_best(void) {
    return ISA_CHOICE(isa_best(), &spatial);
}

/* bound[0 .. parts]: splits [0, n) so that the parts' counts are about equal; accumulates the counts in
 * place. */
static void balance(int32_t *count, int64_t n, int64_t parts, int64_t *bound) {
    int64_t total = 0, part = 1;
    for (int64_t i = 0; i < n; i++) total += count[i];
    bound[0] = 0;
    int64_t sum = 0;
    for (int64_t i = 0; i < n && part < parts; i++) {
        sum += count[i];
        while (part < parts && sum * parts > total * part) bound[part++] = i + 1;
    }
    while (part <= parts) bound[part++] = n;
}

static int64_t part_count(const context *c, int64_t points) {
    const int64_t max = points / GRAIN;
    return max < 1 ? 1 : max < c->threads ? max : c->threads;
}

static bilinear_work bilinear_of(op_call *call) {
    const tensor *map = call->in[0];
    return (bilinear_work){
        .height = map->dim[0],
        .width = map->dim[1],
        .channels = map->dim[2],
        .points = call->in[1]->dim[0],
        .map = input(call, 0),
        .position = input(call, 1),
    };
}

sherf_status cpu_sample_bilinear_forward(op_call *call) {
    bilinear_work k = bilinear_of(call);
    k.y = call->out[0]->data;
    parallel_for(call->c, k.points, GRAIN, spatial_best()->bilinear, &k);
    return SHERF_OK;
}

sherf_status cpu_sample_bilinear_backward(op_call *call) {
    bilinear_work k = bilinear_of(call);
    if (!call->din[0]) return SHERF_OK;
    const int64_t parts = part_count(call->c, k.points), step = 1 + k.points / SAMPLED;
    int32_t *count = arena_alloc(call->c, call->scratch, (size_t)k.height, sizeof *count);
    int64_t *bound = arena_alloc(call->c, call->scratch, (size_t)parts + 1, sizeof *bound);
    if (!count || !bound) return SHERF_NO_MEMORY;
    memset(count, 0, (size_t)k.height * sizeof *count);
    for (int64_t i = 0; parts > 1 && i < k.points; i += step) {
        const float y = k.position[2 * i + 1];
        if (y >= 0 && y < (float)k.height) count[(int64_t)y]++;
    }
    balance(count, k.height, parts, bound);
    k.bound = bound;
    k.dy = call->dout[0]->data;
    k.dmap = input_gradient(call, 0);
    parallel_for(call->c, parts, 1, spatial_best()->bilinear_back, &k);
    return SHERF_OK;
}

static trilinear_work trilinear_of(op_call *call) {
    const tensor *grid = call->in[1];
    return (trilinear_work){
        .size = {grid->dim[2], grid->dim[1], grid->dim[0]},
        .channels = call->in[0]->dim[1],
        .points = call->in[2]->dim[0],
        .x = input(call, 0),
        .grid = grid->data,
        .position = input(call, 2),
    };
}

sherf_status cpu_sample_trilinear_forward(op_call *call) {
    trilinear_work k = trilinear_of(call);
    k.y = call->out[0]->data;
    parallel_for(call->c, k.points, GRAIN, spatial_best()->trilinear, &k);
    return SHERF_OK;
}

sherf_status cpu_sample_trilinear_backward(op_call *call) {
    trilinear_work k = trilinear_of(call);
    if (!call->din[0]) return SHERF_OK;
    const int64_t rows = call->in[0]->dim[0];
    const int64_t parts = part_count(call->c, k.points), step = 1 + k.points / SAMPLED;
    int32_t *count = arena_alloc(call->c, call->scratch, (size_t)rows, sizeof *count);
    int64_t *bound = arena_alloc(call->c, call->scratch, (size_t)parts + 1, sizeof *bound);
    k.row = arena_alloc(call->c, call->scratch, 8 * (size_t)k.points, sizeof *k.row);
    k.weight = arena_alloc(call->c, call->scratch, 8 * (size_t)k.points, sizeof *k.weight);
    if (!count || !bound || !k.row || !k.weight) return SHERF_NO_MEMORY;
    parallel_for(call->c, k.points, GRAIN, spatial_best()->trilinear_corners, &k);
    memset(count, 0, (size_t)rows * sizeof *count);
    for (int64_t i = 0; parts > 1 && i < k.points; i += step)
        for (int64_t j = 8 * i; j < 8 * i + 8 && k.row[j] >= 0; j++) count[k.row[j]]++;
    balance(count, rows, parts, bound);
    k.bound = bound;
    k.dy = call->dout[0]->data;
    k.dx = input_gradient(call, 0);
    parallel_for(call->c, parts, 1, spatial_best()->trilinear_back, &k);
    return SHERF_OK;
}
