/* The spatial inner loops for AVX-512 (the build compiles this file for it). */
#if defined(__AVX512F__)
#define LANES 16
#define SPATIAL_TABLE spatial_avx512
#include "tensor/cpu/spatial_float.h"
#else
typedef int nothing_here;
#endif
