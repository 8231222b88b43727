/* Whether this build has CUDA and this machine a GPU for it; sherf_device_find says the same of verbs. */
#ifndef SHERF_DEVICE_H
#define SHERF_DEVICE_H

#include "base/base.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Into `line`: the name of this process's GPU, or why there is none to compute on. */
bool device_gpu_present(char *line, size_t size);
/* Its number, in CUDA's order: the first one's, and under mpirun that of the process's place on its machine.
 */
int device_gpu_number(void);
/* AUTO becomes what it stands for on this machine. */
sherf_device device_resolve(sherf_device device);

#ifdef __cplusplus
}
#endif
#endif
