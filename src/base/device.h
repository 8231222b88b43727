/* GPUs that this build can use on this machine. sherf_device_find reports the same for verbs. */
#ifndef SHERF_DEVICE_H
#define SHERF_DEVICE_H

#include "base/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Writes to `line` the name of this process's GPU, or the reason why there is none. */
bool device_gpu_present(char *line, size_t size);
/* Its number, in CUDA's order: 0, or under mpirun the process's rank on its machine. */
int device_gpu_number(void);
/* Replaces AUTO by the device for this machine. */
sherf_device device_resolve(sherf_device device);

#ifdef __cplusplus
}
#endif
#endif
