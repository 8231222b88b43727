/* Sparse convolutions on AMX tiles: float32 in and out, products in bf16, float32 sums. Needs ISA_AMX. */
#ifndef SHERF_AMX_SPARSE_H
#define SHERF_AMX_SPARSE_H

#include "tensor/cpu/cpu.h"

/* Whether there are enough channels to make tiles worthwhile. */
bool amx_sparse_fits(const tensor *w);
/* y[a] = (add: +=) sum over taps of W_tap x[rule[a, tap]]; w [O, 3, 3, 3, I]. back: W_tap is transposed, x
 * has O channels and y I, as in the gradient of the data. */
sherf_status amx_sparse_rows(op_call *call, const tensor *x, const int32_t *rule, bool back, bool add,
                             tensor *y);
/* dw[o, tap, i] += sum over a of dy[a, o] x[rule[a, tap], i] */
sherf_status amx_sparse_weights(op_call *call, const tensor *x, const int32_t *rule, const tensor *dy,
                                tensor *dw);
#endif
