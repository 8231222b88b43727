/* bf16 for the CPU kernels: the upper half of a float, rounded to nearest even. */
#ifndef SHERF_CPU_BF16_H
#define SHERF_CPU_BF16_H

#include "base/base.h"

/* to[i] = bf16 of from[i], over the context's threads. Needs ISA_AMX. */
void bf16_round(const context *c, const float *from, uint16_t *to, int64_t n);
#endif
