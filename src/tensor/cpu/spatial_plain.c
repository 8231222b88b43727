/* The spatial inner loops for any processor. */
#define LANES 4
#define SPATIAL_TABLE spatial_plain
#include "tensor/cpu/spatial_float.h"
