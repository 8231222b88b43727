/* ranks: the processes of one training under mpirun; one process without. */
#ifndef SHERF_RANKS_H
#define SHERF_RANKS_H

#include "tensor/block.h"

typedef struct {
    int rank, count;
    int local;    /* processes on this machine */
    bool started; /* here, so that it is finished here */
    const tensor_memory *memory;
    block_group *group; /* of processes with a device each; NULL: alone, or on CPUs */
} ranks;
/* MPI is started only where mpirun started this process. */
sherf_status ranks_open(context *c, ranks *out);
/* broken: after a failure, when sums may have been begun here and nowhere else. */
void ranks_close(ranks *r, bool broken);
/* For sums in this memory, by all processes. NULL, or alone: nothing is needed. */
sherf_status ranks_join(context *c, ranks *r, const tensor_memory *memory);
/* values[i] <- sum over ranks. In a device's memory it does not wait. */
sherf_status ranks_sum(context *c, const ranks *r, const tensor_memory *memory, int64_t n, float *values);
/* flags[i] <- maximum over ranks. */
sherf_status ranks_max(context *c, const ranks *r, int n, int *flags);
/* Every rank's status: SHERF_OK when all are; a rank that is itself fine gets the others' worst. */
sherf_status ranks_agree(context *c, const ranks *r, sherf_status status);

#endif
