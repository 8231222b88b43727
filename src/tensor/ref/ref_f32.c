/* The reference backend in float32: the kernels of dense.inc and spatial.inc, and their table. */
#include <math.h>
#include <string.h>

#include "tensor/ref/ref.h"

typedef float real;
#define KERNEL(name) REF_NAME(name, f32)
#include "tensor/ref/dense.inc"
#include "tensor/ref/spatial.inc"

#define FORWARD(op) .forward[OP_##op] = ref_##op##_forward_f32,
#define BOTH(op) FORWARD(op).backward[OP_##op] = ref_##op##_backward_f32,
const backend backend_ref_f32 = {.name = "reference f32", .real = T_F32, OPS(BOTH, FORWARD, BOTH)};
