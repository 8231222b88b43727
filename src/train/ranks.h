/* ranks: the processes of one training under mpirun; one process without. */
#ifndef SHERF_RANKS_H
#define SHERF_RANKS_H

#include "base/base.h"

typedef struct {
    int rank, count;
    int local;    /* processes on this machine */
    bool started; /* here, so that it is finished here */
} ranks;
/* MPI is started only where mpirun started this process. */
sherf_status ranks_open(context *c, ranks *out);
void ranks_close(ranks *r);
/* values[i] <- sum over ranks. */
sherf_status ranks_sum(context *c, const ranks *r, int64_t n, float *values);
/* flags[i] <- maximum over ranks. */
sherf_status ranks_max(context *c, const ranks *r, int n, int *flags);
/* Every rank's status: SHERF_OK when all are; a rank that is itself fine gets the others' worst. */
sherf_status ranks_agree(context *c, const ranks *r, sherf_status status);

#endif
