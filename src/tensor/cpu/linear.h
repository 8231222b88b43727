/* The weights' gradient of linear layers in float32, which 1 x 1 convolutions share. */
#ifndef SHERF_CPU_LINEAR_H
#define SHERF_CPU_LINEAR_H

#include "tensor/cpu/cpu.h"

typedef struct {
    int64_t R, I, O;
    float gain;
} linear_sizes;

/* dw[O,I] += gain dy[R,O]^T x[R,I]. Rows are split into blocks that depend only on the shape, and the blocks'
 * sums are joined in order, so the result does not depend on the number of threads. */
sherf_status linear_weights_add(op_call *call, const linear_sizes *n, const float *x, const float *dy,
                                float *dw);
#endif
