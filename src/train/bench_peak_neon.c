/* bench_peak.h for NEON. */
#if defined(__aarch64__)
#define LANES 4
#define CHAINS 24
#define PEAK bench_peak_neon
#include "train/bench_peak.h"
#else
typedef int nothing_here;
#endif
