/* bench_peak.h for AVX2. */
#if defined(__AVX2__)
#define LANES 8
#define PEAK bench_peak_avx2
#include "train/bench_peak.h"
#else
typedef int nothing_here;
#endif
