/* The processor's peak: as many multiply-adds per second as registers allow. For files that are compiled once
 * per instruction set: define LANES and PEAK before the inclusion. */
#include "base/simd.h"

/* Independent ones, enough for two units of four cycles, and for NEON four; 16 and 32 registers hold them. */
#ifndef CHAINS
#define CHAINS 12
#endif

/* `rounds` multiply-adds of each of CHAINS * LANES numbers, to the number itself, as NEON's add to a
 * register; their sum, which keeps them from being left out.
 */
float PEAK(int64_t rounds);
float PEAK(int64_t rounds) {
    vf x[CHAINS];
    const vf a = splat(1e-7f);
    _Pragma("GCC unroll 24") for (int k = 0; k < CHAINS; k++) x[k] = splat((float)(k + 1));
    for (int64_t i = 0; i < rounds; i++) {
        _Pragma("GCC unroll 24") for (int k = 0; k < CHAINS; k++) x[k] += x[k] * a;
    }
    float sum = 0;
    for (int k = 0; k < CHAINS; k++) sum += x[k][0];
    return sum;
}
