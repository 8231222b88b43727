/* The CPU backend's table: its own kernels, a few of the reference's, and the gradients that kernels write
 * instead of adding to. */
#include "tensor/cpu/cpu.h"
#include "tensor/ref/ref.h"

#define FORWARD(op) .forward[OP_##op] = cpu_##op##_forward,
#define BOTH(op) FORWARD(op).backward[OP_##op] = cpu_##op##_backward,
#define SHARED(op) .forward[OP_##op] = ref_##op##_forward_f32, .backward[OP_##op] = ref_##op##_backward_f32,
const backend backend_cpu = {
    .name = "CPU",
    .real = T_F32,
    OPS(BOTH, FORWARD, SHARED)
        /* The large ones: clearing and then adding passes over memory twice. */
        .writes = {[OP_linear] = 1,
                   [OP_conv2d] = 1,
                   [OP_conv2d_transpose] = 1,
                   [OP_sparse_conv] = 1,
                   [OP_scale_channels] = 1,
                   [OP_batch_norm] = 1,
                   [OP_bias_act] = 1,
                   [OP_add] = 3,
                   [OP_scale] = 1},
};
