/* The reference backend in double, for checks of gradients against central differences. */
#include <math.h>
#include <string.h>

#include "tensor/ref/ref.h"

typedef double real;
#define KERNEL(name) REF_NAME(name, f64)
#include "tensor/ref/dense.inc"
#include "tensor/ref/spatial.inc"

#define FORWARD(op) .forward[OP_##op] = ref_##op##_forward_f64,
#define BOTH(op) FORWARD(op).backward[OP_##op] = ref_##op##_backward_f64,
const backend backend_ref_f64 = {.name = "reference f64", .real = T_F64, OPS(BOTH, FORWARD, BOTH)};
