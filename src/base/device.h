/* Whether this build has CUDA and this machine a GPU for it; sherf_device_find says the same of verbs. */
#ifndef SHERF_DEVICE_H
#define SHERF_DEVICE_H

#include "base/base.h"

/* Into `line`: the first GPU's name, or why there is none to compute on. */
bool device_gpu_present(char *line, size_t size);

#endif
