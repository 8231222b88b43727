/* As many multiply-adds a second as registers allow, for files that are compiled once per instruction set:
 * define LANES and PEAK before the inclusion. */
#include "base/simd.h"

enum { CHAINS = 12 }; /* independent ones, enough for two units of four cycles; 16 registers hold them */

/* `rounds` multiply-adds of each of CHAINS * LANES numbers; their sum, which keeps them from being left out.
 */
float PEAK(int64_t rounds);
float PEAK(int64_t rounds) {
    vf x[CHAINS];
    const vf a = splat(0.999f), b = splat(0.001f);
    _Pragma("GCC unroll 12") for (int k = 0; k < CHAINS; k++) x[k] = splat((float)k);
    for (int64_t i = 0; i < rounds; i++) {
        _Pragma("GCC unroll 12") for (int k = 0; k < CHAINS; k++) x[k] = x[k] * a + b;
    }
    float sum = 0;
    for (int k = 0; k < CHAINS; k++) sum += x[k][0];
    return sum;
}
