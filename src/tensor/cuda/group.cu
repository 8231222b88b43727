/* Sums over processes by NCCL, which is opened if there is more than one process. They run on a stream of
 * their own, so that finished gradients are summed while others are still computed. */
#include <dlfcn.h>
#include <new>
#include <stdlib.h>
#include <string.h>

#include "tensor/cuda/cuda.h"

struct block_group {
    void *communicator;
    cudaStream_t own;
    cudaEvent_t passed;
};

namespace cuda_backend {

/* NCCL 2's interface, as in nccl.h: 0 is success, and the values are stable. */
struct nccl_name {
    char bytes[GROUP_NAME];
};
enum { NCCL_FLOAT = 7, NCCL_SUM = 0 };

struct nccl {
    int (*name)(nccl_name *out);
    int (*join)(void **communicator, int count, nccl_name name, int rank);
    int (*sum)(const void *from, void *to, size_t n, int type, int operation, void *communicator,
               cudaStream_t on);
    int (*leave)(void *communicator);
    int (*abort)(void *communicator);
    const char *(*text)(int code);
    bool good;
};

static nccl nccl_open() {
    nccl n = {};
    void *library = dlopen("libnccl.so.2", RTLD_NOW | RTLD_LOCAL);
    if (!library) library = dlopen("/usr/local/cuda/lib64/libnccl.so.2", RTLD_NOW | RTLD_LOCAL);
    if (!library) return n;
    n.name = (decltype(n.name))dlsym(library, "ncclGetUniqueId");
    n.join = (decltype(n.join))dlsym(library, "ncclCommInitRank");
    n.sum = (decltype(n.sum))dlsym(library, "ncclAllReduce");
    n.leave = (decltype(n.leave))dlsym(library, "ncclCommDestroy");
    n.abort = (decltype(n.abort))dlsym(library, "ncclCommAbort");
    n.text = (decltype(n.text))dlsym(library, "ncclGetErrorString");
    n.good = n.name && n.join && n.sum && n.leave && n.abort && n.text;
    return n;
}

static const nccl &library() {
    static const nccl n = nccl_open();
    return n;
}

static sherf_status checked(context *c, const char *what, int code) {
    if (!code) return SHERF_OK;
    return failure(c, SHERF_UNSUPPORTED, "%s: NCCL says: %s", what, library().text(code));
}

static sherf_status opened(context *c) {
    if (library().good) return SHERF_OK;
    return failure(c, SHERF_UNSUPPORTED, "several GPUs: NCCL (libnccl.so.2) cannot be opened");
}

static sherf_status name(context *c, char *out) {
    nccl_name n;
    sherf_status status = opened(c);
    if (!out) return status;
    if (status == SHERF_OK) status = checked(c, "a group of processes", library().name(&n));
    if (status == SHERF_OK) memcpy(out, n.bytes, GROUP_NAME);
    return status;
}

static void leave(block_group *g, bool broken) {
    if (!g) return;
    if (g->communicator && broken) library().abort(g->communicator);
    if (g->own && !broken) cudaStreamSynchronize(g->own);
    if (g->communicator && !broken) library().leave(g->communicator);
    if (g->passed) cudaEventDestroy(g->passed);
    if (g->own) cudaStreamDestroy(g->own);
    delete g;
}

static sherf_status join(context *c, const char given[GROUP_NAME], int rank, int count, block_group **out) {
    nccl_name n;
    *out = nullptr;
    sherf_status status = opened(c);
    if (status != SHERF_OK) return status;
    /* In a ring the order of additions depends only on the processes' ranks, so the same GPUs give the same
     * bits; with NCCL's other algorithms it depends on the switch between them. A user's own choice stays. */
    setenv("NCCL_ALGO", "Ring", 0);
    memcpy(n.bytes, given, GROUP_NAME);
    block_group *g = new (std::nothrow) block_group();
    if (!g) return failure(c, SHERF_NO_MEMORY, "out of memory: a group of processes");
    stream(); /* chooses this thread's GPU */
    if (cudaStreamCreateWithFlags(&g->own, cudaStreamNonBlocking) != cudaSuccess ||
        cudaEventCreateWithFlags(&g->passed, cudaEventDisableTiming) != cudaSuccess)
        status = finished(c, "a stream for the sums");
    if (status == SHERF_OK)
        status = checked(c, "joining the other processes", library().join(&g->communicator, count, n, rank));
    if (status == SHERF_OK)
        *out = g;
    else
        leave(g, false);
    return status;
}

/* `later` continues after all work put into `earlier` so far. */
static sherf_status follow(context *c, block_group *g, cudaStream_t earlier, cudaStream_t later) {
    if (cudaEventRecord(g->passed, earlier) == cudaSuccess) cudaStreamWaitEvent(later, g->passed, 0);
    return finished(c, "the order of two streams");
}

static sherf_status sum(context *c, block_group *g, int64_t n, float *values) {
    if (!n) return SHERF_OK;
    sherf_status status = follow(c, g, stream(), g->own);
    if (status != SHERF_OK) return status;
    return checked(c, "a sum over processes",
                   library().sum(values, values, (size_t)n, NCCL_FLOAT, NCCL_SUM, g->communicator, g->own));
}

static sherf_status wait(context *c, block_group *g) {
    return follow(c, g, g->own, stream());
}

const block_groups process_groups = {name, join, sum, wait, leave};

} // namespace cuda_backend
