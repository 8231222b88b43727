/* The spatial inner loops for NEON. */
#if defined(__aarch64__)
#define LANES 4
#define SPATIAL_TABLE spatial_neon
#include "tensor/cpu/spatial_float.h"
#else
typedef int nothing_here;
#endif
