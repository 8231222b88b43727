/* The memory of this backend's tensors: accounting, and uploads that do not wait. Uploads go through a ring
 * of pinned memory: after the copy into the ring the source may change at once, and a piece of the ring is
 * reused only after the stream has passed the copy out of it. */
#include <mutex>
#include <new>
#include <string.h>

#include "tensor/cuda/memory.h"

namespace cuda_backend {

/* ---- how much is taken ---- */
struct piece_taken {
    void *p;
    size_t bytes;
    piece_taken *next;
};
static struct {
    std::mutex lock;
    piece_taken *newest;
    size_t now, max;
} account;

static void *take(context *c, size_t bytes) {
    void *p = device_take(c, bytes);
    piece_taken *one = p ? new (std::nothrow) piece_taken : nullptr;
    if (!one) return p; /* then it is not counted */
    std::lock_guard<std::mutex> hold(account.lock);
    *one = {p, bytes, account.newest};
    account.newest = one;
    account.now += bytes;
    if (account.now > account.max) account.max = account.now;
    return p;
}

static void give(void *p) {
    account.lock.lock();
    piece_taken **at = &account.newest;
    while (*at && (*at)->p != p) at = &(*at)->next;
    piece_taken *one = *at;
    if (one) {
        *at = one->next;
        account.now -= one->bytes;
    }
    account.lock.unlock();
    delete one;
    device_give(p);
}

static size_t peak() {
    std::lock_guard<std::mutex> hold(account.lock);
    return account.max;
}

/* ---- uploads ---- */
constexpr uint64_t ring_bytes = 64 << 20, piece_max = ring_bytes / 4;
enum { MARKS = 256, ALIGNMENT = 256 };

/* Positions count bytes from the beginning and never wrap; position p is data[p % ring_bytes]. Bytes between
 * free_to and head are in transit, in pieces with a mark after each one's copy. */
struct upload_ring {
    std::mutex lock;
    char *data = nullptr;
    bool tried = false;
    uint64_t head = 0, free_to = 0;
    struct {
        mark *passed;
        uint64_t end;
    } piece[MARKS] = {};
    unsigned first = 0, count = 0;
};

static bool ring_open(upload_ring &r) {
    if (r.tried) return r.data != nullptr;
    r.tried = true;
    for (int i = 0; i < MARKS; i++)
        if (!(r.piece[i].passed = mark_make())) return false;
    r.data = (char *)pinned_take(ring_bytes);
    return r.data != nullptr;
}

static void ring_free_oldest(upload_ring &r) {
    mark_wait(r.piece[r.first].passed);
    r.free_to = r.piece[r.first].end;
    r.first = (r.first + 1) % MARKS;
    r.count--;
}

/* Takes room for a contiguous piece. */
static char *ring_take(upload_ring &r, uint64_t bytes) {
    const uint64_t rounded = (bytes + ALIGNMENT - 1) / ALIGNMENT * ALIGNMENT,
                   left = ring_bytes - r.head % ring_bytes;
    if (left < rounded) r.head += left;
    while (r.count == MARKS || (r.count && r.head + rounded - r.free_to > ring_bytes)) ring_free_oldest(r);
    if (!r.count) r.free_to = r.head;
    char *piece = r.data + r.head % ring_bytes;
    r.head += rounded;
    return piece;
}

/* Sets a mark after the copy out of the piece taken last. */
static void ring_mark(upload_ring &r) {
    auto &last = r.piece[(r.first + r.count) % MARKS];
    last.end = r.head;
    r.count++;
    mark_set(last.passed);
}

static sherf_status upload(context *c, void *to, const void *from, size_t bytes) {
    static upload_ring ring;
    std::lock_guard<std::mutex> hold(ring.lock);
    if (!ring_open(ring)) { /* copies then read the caller's memory, so the caller must wait for them */
        const sherf_status status = copy_begin(c, TO_DEVICE, to, from, bytes);
        return status == SHERF_OK ? wait_for_all(c) : status;
    }
    for (size_t done = 0; done < bytes;) {
        const size_t n = bytes - done < piece_max ? bytes - done : piece_max;
        char *piece = ring_take(ring, n);
        memcpy(piece, (const char *)from + done, n);
        const sherf_status status = copy_begin(c, TO_DEVICE, (char *)to + done, piece, n);
        ring_mark(ring);
        if (status != SHERF_OK) return status;
        done += n;
    }
    return SHERF_OK;
}

/* ---- the rest ---- */
static sherf_status download(context *c, void *to, const void *from, size_t bytes) {
    const sherf_status status = copy_begin(c, TO_HOST, to, from, bytes);
    return status == SHERF_OK ? wait_for_all(c) : status;
}

static sherf_status copy(context *c, void *to, const void *from, size_t bytes) {
    return copy_begin(c, WITHIN, to, from, bytes);
}

#ifdef CUDA_EMULATED
#define MEMORY_NAME "emulated CUDA"
#else
#define MEMORY_NAME "CUDA"
#endif
const tensor_memory device_memory = {
    MEMORY_NAME, {take, give}, upload, download, copy, clear_begin, peak, &block_arithmetic, &process_groups};

} // namespace cuda_backend
