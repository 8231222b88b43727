/* bench_peak.h for AVX-512. */
#if defined(__AVX512F__)
#define LANES 16
#define PEAK bench_peak_avx512
#include "train/bench_peak.h"
#else
typedef int nothing_here;
#endif
