/* The spatial inner loops for AVX2 (the build compiles this file for it). */
#if defined(__AVX2__)
#define LANES 8
#define SPATIAL_TABLE spatial_avx2
#include "tensor/cpu/spatial_float.h"
#else
typedef int nothing_here;
#endif
