/* The processes of one training, over MPI. */
#include <stdlib.h>

#include "train/ranks.h"

#ifdef SHERF_HAVE_MPI
#include <mpi.h>

static sherf_status check(context *c, int code, const char *what) {
    if (code == MPI_SUCCESS) return SHERF_OK;
    char text[MPI_MAX_ERROR_STRING] = "";
    int length;
    MPI_Error_string(code, text, &length);
    return failure(c, SHERF_UNSUPPORTED, "MPI: %s: %s", what, text);
}

sherf_status ranks_open(context *c, ranks *out) {
    *out = (ranks){.count = 1, .local = 1};
    const char *local = getenv("OMPI_COMM_WORLD_LOCAL_SIZE");
    int running = 0, finished = 0, level = 0;
    if (!getenv("OMPI_COMM_WORLD_SIZE")) return SHERF_OK;
    MPI_Initialized(&running);
    MPI_Finalized(&finished);
    if (finished) return failure(c, SHERF_UNSUPPORTED, "MPI: a process under mpirun can train only once");
    if (!running) {
        sherf_status status = check(c, MPI_Init_thread(NULL, NULL, MPI_THREAD_FUNNELED, &level), "start");
        if (status != SHERF_OK) return status;
        out->started = true;
    }
    MPI_Comm_set_errhandler(MPI_COMM_WORLD, MPI_ERRORS_RETURN);
    MPI_Comm_rank(MPI_COMM_WORLD, &out->rank);
    MPI_Comm_size(MPI_COMM_WORLD, &out->count);
    if (local && atoi(local) > 0) out->local = atoi(local);
    return SHERF_OK;
}

static void finish(ranks *r) {
    if (r->started) MPI_Finalize();
}

static sherf_status share_name(context *c, char name[GROUP_NAME]) {
    return check(c, MPI_Bcast(name, GROUP_NAME, MPI_BYTE, 0, MPI_COMM_WORLD), "name of a group");
}

static sherf_status sum_here(context *c, const ranks *r, int64_t n, float *values) {
    enum { PART = 1 << 24 }; /* MPI counts are int */
    sherf_status status = SHERF_OK;
    for (int64_t i = 0; r->count > 1 && i < n && status == SHERF_OK; i += PART) {
        int part = n - i < PART ? (int)(n - i) : PART;
        status = check(c, MPI_Allreduce(MPI_IN_PLACE, values + i, part, MPI_FLOAT, MPI_SUM, MPI_COMM_WORLD),
                       "sum over processes");
    }
    return status;
}

sherf_status ranks_max(context *c, const ranks *r, int n, int *flags) {
    if (r->count == 1) return SHERF_OK;
    return check(c, MPI_Allreduce(MPI_IN_PLACE, flags, n, MPI_INT, MPI_MAX, MPI_COMM_WORLD),
                 "agreement of processes");
}
#else
sherf_status ranks_open(context *c, ranks *out) {
    *out = (ranks){.count = 1, .local = 1};
    const char *size = getenv("OMPI_COMM_WORLD_SIZE");
    if (size && atoi(size) > 1)
        return failure(c, SHERF_UNSUPPORTED, "mpirun: this build trains in one process only");
    return SHERF_OK;
}
static void finish(ranks *r) {}
static sherf_status share_name(context *c, char name[GROUP_NAME]) {
    return SHERF_OK;
}
static sherf_status sum_here(context *c, const ranks *r, int64_t n, float *values) {
    return SHERF_OK;
}
sherf_status ranks_max(context *c, const ranks *r, int n, int *flags) {
    return SHERF_OK;
}
#endif

sherf_status ranks_join(context *c, ranks *r, const tensor_memory *memory) {
    char name[GROUP_NAME] = "";
    int devices[2] = {memory != NULL, memory == NULL};
    if (r->count == 1) return SHERF_OK;
    sherf_status status = ranks_max(c, r, 2, devices);
    if (status == SHERF_OK && devices[0] && devices[1])
        status = failure(c, SHERF_UNSUPPORTED,
                         "some processes of this training have a GPU and others none; choose with --device");
    if (status != SHERF_OK || !memory) return status;
    /* Asked by all, so that none waits for one that cannot join. */
    status = ranks_agree(c, r, memory->groups->name(c, r->rank ? NULL : name));
    if (status == SHERF_OK) status = share_name(c, name);
    if (status == SHERF_OK) status = memory->groups->join(c, name, r->rank, r->count, &r->group);
    r->memory = memory;
    return status;
}

void ranks_close(ranks *r, bool broken) {
    if (r->group) r->memory->groups->leave(r->group, broken);
    r->group = NULL;
    finish(r);
    r->started = false;
}

sherf_status ranks_sum(context *c, const ranks *r, const tensor_memory *memory, int64_t n, float *values) {
    if (r->count == 1) return SHERF_OK;
    if (!memory) return sum_here(c, r, n, values);
    const sherf_status status = memory->groups->sum(c, r->group, n, values);
    return status == SHERF_OK ? memory->groups->wait(c, r->group) : status;
}

sherf_status ranks_agree(context *c, const ranks *r, sherf_status status) {
    int worst = (int)status;
    sherf_status mpi = ranks_max(c, r, 1, &worst);
    if (status != SHERF_OK) return status;
    if (mpi != SHERF_OK) return mpi;
    if (worst == SHERF_OK) return SHERF_OK;
    return failure(c, (sherf_status)worst, "another process of this training has stopped");
}
