/* bench_peak.h in plain C. */
#define LANES 4
#define PEAK bench_peak_plain
#include "train/bench_peak.h"
