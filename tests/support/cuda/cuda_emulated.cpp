/* CUDA's language emulated on the host: fibres, barriers, the device's memory (cuda_emulated.h). */
#include <deque>
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <ucontext.h>
#include <vector>

#include "tensor/cuda/memory.h"
#include "tensor/cuda/product.h"

#if defined(__SANITIZE_ADDRESS__)
#define FIBRES_WATCHED 1
#elif defined(__has_feature)
#if __has_feature(address_sanitizer)
#define FIBRES_WATCHED 1
#endif
#endif
#ifdef FIBRES_WATCHED
#include <sanitizer/common_interface_defs.h>
#endif

dim3 threadIdx, blockIdx, blockDim, gridDim;
int cuda_emulated_order;
size_t cuda_emulated_bytes;

namespace cuda_backend {

/* ---- fibres ---- */
enum { STACK_BYTES = 128 << 10, THREADS_MAX = 1024 };
enum thread_state { FRESH, READY, AT_WARP, AT_BLOCK, DONE };

struct fibre {
    ucontext_t place; /* where it begins; under the sanitizer, its current position */
    jmp_buf stop;     /* its current position, once it has begun */
    bool begun;
    const void *stack;
    size_t stack_bytes;
    void *watched; /* kept by the address sanitizer */
};

struct thread {
    thread_state state;
    fibre *on;         /* where it stopped at a barrier */
    const void *given; /* at a warp's barrier, the value that it shows to the other lanes */
    size_t given_bytes;
};
enum { GIVEN_MAX = 32 };
/* The values that the lanes of each warp showed at its newest barrier. */
static unsigned char shown[THREADS_MAX / WARP][WARP][GIVEN_MAX] __attribute__((aligned(16)));

/* Copies that are done when something waits for them, and not sooner. */
struct pending {
    void *to;
    const void *from;
    int group;
};
static std::vector<pending> copies[THREADS_MAX];
static int groups[THREADS_MAX]; /* number of closed ones */

static std::vector<fibre *> idle;
static thread threads[THREADS_MAX];
static int thread_count, fresh_count, current; /* fresh: not yet begun */
static const std::function<void()> *kernel_body;
static fibre scheduler, *running;

[[noreturn]] static void broken(const char *what) {
    fprintf(stderr, "emulated kernel: %s\n", what);
    abort();
}

/* Back on a fibre after the scheduler, or on the scheduler, whose own stack is then known. */
static void changed(fibre *now) {
#ifdef FIBRES_WATCHED
    const void *stack;
    size_t bytes;
    __sanitizer_finish_switch_fiber(now->watched, &stack, &bytes);
    if (now == &scheduler) return;
    scheduler.stack = stack;
    scheduler.stack_bytes = bytes;
#endif
}

static void change(fibre *from, fibre *to) {
#ifdef FIBRES_WATCHED
    __sanitizer_start_switch_fiber(&from->watched, to->stack, to->stack_bytes);
#endif
    running = to;
#ifdef FIBRES_WATCHED
    swapcontext(&from->place, &to->place);
#else
    /* swapcontext makes two system calls, so it is used only to begin */
    from->begun = true;
    if (!_setjmp(from->stop)) {
        if (to->begun) _longjmp(to->stop, 1);
        setcontext(&to->place);
    }
#endif
    changed(from);
}

static void step_into(int i) {
    current = i;
    threadIdx = dim3(i % blockDim.x, i / blockDim.x % blockDim.y, i / blockDim.x / blockDim.y);
}

/* The next thread in the requested order. */
static int fresh_take() {
    const int i = cuda_emulated_order ? fresh_count - 1 : thread_count - fresh_count;
    fresh_count--;
    return i;
}

/* A fibre runs threads one after another until one stops at a barrier, so kernels without barriers need only
 * one. */
static void fibre_main() {
    changed(running);
    for (;;) {
        while (fresh_count > 0) {
            step_into(fresh_take());
            threads[current].state = READY;
            (*kernel_body)();
            threads[current].state = DONE;
        }
        fibre *self = running;
        idle.push_back(self);
        change(self, &scheduler);
    }
}

static fibre *fibre_make() {
    fibre *f = new fibre();
    void *stack = malloc(STACK_BYTES);
    f->stack = stack;
    f->stack_bytes = STACK_BYTES;
    getcontext(&f->place);
    f->place.uc_stack.ss_sp = stack;
    f->place.uc_stack.ss_size = STACK_BYTES;
    f->place.uc_link = nullptr;
    makecontext(&f->place, fibre_main, 0);
    return f;
}

static fibre *fibre_take() {
    if (idle.empty()) return fibre_make();
    fibre *f = idle.back();
    idle.pop_back();
    return f;
}

static void wait(thread_state barrier) {
    thread *self = &threads[current];
    const int at = current;
    self->state = barrier;
    self->on = running;
    change(running, &scheduler);
    step_into(at);
}

/* Lets the threads [begin, end) continue when all unfinished ones are at the barrier. */
static bool release(int begin, int end, thread_state barrier) {
    int waiting = 0;
    for (int i = begin; i < end; i++) {
        if (threads[i].state == DONE) continue;
        if (threads[i].state != barrier) return false;
        waiting++;
    }
    if (!waiting) return false;
    if (barrier == AT_WARP && waiting < WARP) broken("not all lanes of a warp come to its barrier");
    for (int i = begin; i < end && barrier == AT_WARP; i++)
        memcpy(shown[begin / WARP][i - begin], threads[i].given, threads[i].given_bytes);
    for (int i = begin; i < end; i++)
        if (threads[i].state == barrier) threads[i].state = READY;
    return true;
}

static bool release_any() {
    bool any = release(0, thread_count, AT_BLOCK);
    for (int w = 0; w < thread_count; w += WARP)
        any |= release(w, w + WARP < thread_count ? w + WARP : thread_count, AT_WARP);
    return any;
}

static void run_block() {
    for (int i = 0; i < thread_count; i++) threads[i].state = FRESH;
    fresh_count = thread_count;
    for (;;) {
        while (fresh_count > 0) change(&scheduler, fibre_take());
        bool left = false;
        for (int k = 0; k < thread_count; k++) {
            const int i = cuda_emulated_order ? thread_count - 1 - k : k;
            if (threads[i].state == READY) {
                step_into(i);
                change(&scheduler, threads[i].on);
            }
            left |= threads[i].state != DONE;
        }
        if (!left) break;
        if (!release_any()) broken("its threads wait at different barriers");
    }
    for (int i = 0; i < thread_count; i++)
        if (!copies[i].empty()) broken("a thread ends with copies that it has not waited for");
}

/* ---- memory: locked from an op's end to the next launch or copy ----
 * A region ends at the end of a mapping of whole huge pages. So locking changes one entry of the page table
 * per huge page instead of 512, and nothing lies beyond a region's end. */
enum { PAGE_BYTES = 4096, HUGE_BYTES = 2 << 20 };
struct region {
    char *data;
    size_t bytes;
    char *block, *mapping; /* the huge pages; the whole mapping */
    size_t block_bytes, mapping_bytes;
};
static std::vector<region> regions;

static bool locked = true;

static void lock_memory(bool lock) {
    if (lock == locked) return;
    locked = lock;
    for (const region &r : regions)
        mprotect(r.block, r.block_bytes, lock ? PROT_NONE : PROT_READ | PROT_WRITE);
}

static bool region_map(size_t bytes, region *r) {
    r->bytes = bytes;
    r->block_bytes = (bytes + HUGE_BYTES - 1) / HUGE_BYTES * HUGE_BYTES;
    r->mapping_bytes = r->block_bytes + HUGE_BYTES + PAGE_BYTES;
    void *p = mmap(nullptr, r->mapping_bytes, PROT_NONE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (p == MAP_FAILED) return false;
    r->mapping = (char *)p;
    r->block = r->mapping + (HUGE_BYTES - (uintptr_t)p % HUGE_BYTES) % HUGE_BYTES;
    r->data = r->block + r->block_bytes - bytes;
    madvise(r->block, r->block_bytes, MADV_HUGEPAGE);
    if (!mprotect(r->block, r->block_bytes, PROT_READ | PROT_WRITE)) return true;
    munmap(r->mapping, r->mapping_bytes);
    return false;
}

/* Copies out of pinned memory happen as late as possible: when something waits for them, or before work that
 * must follow them. So memory that is overwritten too early is found. */
struct late_copy {
    void *to;
    const void *from;
    size_t bytes;
};
static std::deque<late_copy> late;
static uint64_t late_done; /* among all copies so far */

static void copy_late(uint64_t until) {
    lock_memory(false);
    for (; !late.empty() && late_done < until; late_done++) {
        memmove(late.front().to, late.front().from, late.front().bytes);
        late.pop_front();
    }
}

/* Called before work in the stream. */
static void begin_work() {
    copy_late(UINT64_MAX);
}

void emulate(dim3 grid, dim3 block, const std::function<void()> &body) {
    thread_count = (int)(block.x * block.y * block.z);
    if (thread_count < 1 || thread_count > THREADS_MAX || grid.x < 1 || grid.y < 1 || grid.y > 65535)
        broken("a launch of a size that no GPU takes");
    begin_work();
    blockDim = block;
    gridDim = grid;
    kernel_body = &body;
    const uint64_t blocks = (uint64_t)grid.x * grid.y * grid.z;
    for (uint64_t k = 0; k < blocks; k++) {
        const uint64_t b = cuda_emulated_order ? blocks - 1 - k : k;
        blockIdx =
            dim3((unsigned)(b % grid.x), (unsigned)(b / grid.x % grid.y), (unsigned)(b / grid.x / grid.y));
        run_block();
    }
}

/* The lanes' values, GIVEN_MAX bytes apart, valid until this lane reaches a barrier again. */
static const unsigned char (*exchange(const void *mine, size_t bytes))[GIVEN_MAX] {
    threads[current].given = mine;
    threads[current].given_bytes = bytes;
    wait(AT_WARP);
    return shown[current / WARP];
}

template <typename T> static T of_lane(const unsigned char (*lanes)[GIVEN_MAX], int lane, int i = 0) {
    T v;
    memcpy(&v, lanes[lane] + (size_t)i * sizeof v, sizeof v);
    return v;
}

float warp_sum(float v) {
    const unsigned char(*lanes)[GIVEN_MAX] = exchange(&v, sizeof v);
    float sum[WARP], next[WARP];
    for (int lane = 0; lane < WARP; lane++) sum[lane] = of_lane<float>(lanes, lane);
    for (int step = WARP / 2; step > 0; step /= 2) {
        for (int lane = 0; lane < WARP; lane++) next[lane] = sum[lane] + sum[lane ^ step];
        memcpy(sum, next, sizeof sum);
    }
    return sum[threadIdx.x % WARP];
}

float quad_sum(float v) {
    const unsigned char(*lanes)[GIVEN_MAX] = exchange(&v, sizeof v);
    const int lane = current % WARP;
    auto at = [&](int other) { return of_lane<float>(lanes, other); };
    return (at(lane) + at(lane ^ 1)) + (at(lane ^ 2) + at(lane ^ 3));
}

uint32_t warp_ballot(bool v) {
    const uint32_t mine = v;
    const unsigned char(*lanes)[GIVEN_MAX] = exchange(&mine, sizeof mine);
    uint32_t bits = 0;
    for (int lane = 0; lane < WARP; lane++) bits |= of_lane<uint32_t>(lanes, lane) << lane;
    return bits;
}

int32_t warp_before(int32_t v) {
    const unsigned char(*lanes)[GIVEN_MAX] = exchange(&v, sizeof v);
    int32_t sum = 0;
    for (int lane = 0; lane < current % WARP; lane++) sum += of_lane<int32_t>(lanes, lane);
    return sum;
}

int bits_set(uint32_t bits) {
    return __builtin_popcount(bits);
}

void warp_barrier() {
    const int nothing = 0;
    exchange(&nothing, sizeof nothing);
}

static float of_bf16(uint32_t pair, int high) {
    const uint32_t bits = high ? pair & 0xffff0000u : pair << 16;
    float v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

/* The fragments as in PTX: with g = lane / 4 and t = lane % 4, a[] holds rows g and g + 8 of columns 2 t and
 * 2 t + 1, then the same for columns 8 further; b[] holds rows 2 t and 2 t + 1 of column g, then 8 further;
 * c[] holds columns 2 t and 2 t + 1 of row g, then of row g + 8. */
void mma_bf16(float c[4], const uint32_t a[4], const uint32_t b[2]) {
    const uint32_t mine[6] = {a[0], a[1], a[2], a[3], b[0], b[1]};
    const unsigned char(*lanes)[GIVEN_MAX] = exchange(mine, sizeof mine);
    const int g = current % WARP / 4, t = current % 4;
    for (int i = 0; i < 4; i++) {
        const int row = i / 2, column = 2 * t + i % 2;
        float sum = 0;
        for (int k = 0; k < 16; k++) {
            const int far = k / 8, quarter = k % 8 / 2;
            const uint32_t left = of_lane<uint32_t>(lanes, 4 * g + quarter, 2 * far + row);
            const uint32_t right = of_lane<uint32_t>(lanes, 4 * column + quarter, 4 + far);
            sum += of_bf16(left, k % 2) * of_bf16(right, k % 2);
        }
        c[i] += sum;
    }
}

uint32_t transpose8(uint32_t v) {
    const unsigned char(*lanes)[GIVEN_MAX] = exchange(&v, sizeof v);
    const int g = current % WARP / 4, t = current % 4;
    auto at = [&](int row, int column) {
        return of_lane<uint32_t>(lanes, 4 * row + column / 2) >> column % 2 * 16 & 0xffff;
    };
    return at(2 * t, g) | at(2 * t + 1, g) << 16;
}

uint32_t pack_bf16(float low, float high) {
    const float v[2] = {low, high};
    uint32_t bits[2];
    memcpy(bits, v, sizeof bits);
    for (uint32_t &one : bits) one = (one + 0x7fff + (one >> 16 & 1)) >> 16;
    return bits[0] | bits[1] << 16;
}

float unpack_bf16(uint32_t pair, int high) {
    return of_bf16(pair, high);
}

float half_value(uint16_t half) {
    const uint32_t exponent = half >> 10 & 31, fraction = half & 1023;
    const float size = exponent == 31 ? (fraction ? NAN : INFINITY)
                                      : ldexpf((float)(exponent ? fraction + 1024 : fraction),
                                               (exponent ? (int)exponent : 1) - 25);
    return half >> 15 ? -size : size;
}

/* Rounds to nearest, ties to even; beyond the largest value the result is infinite. */
uint16_t half_of(float v) {
    const uint16_t sign = signbit(v) ? 0x8000 : 0;
    if (isnan(v)) return 0x7fff;
    int exponent = 0;
    frexpf(v, &exponent); /* |v| in [2^(exponent - 1), 2^exponent) */
    exponent = exponent < -13 ? -13 : exponent;
    const float unit = ldexpf(1, exponent - 11), steps = rintf(fabsf(v) / unit);
    const float size = steps * unit;
    if (!(size < 65520)) return sign | 0x7c00;
    if (steps < 1024) return (uint16_t)(sign | (uint16_t)steps);
    frexpf(size, &exponent);
    const uint16_t fraction = (uint16_t)(ldexpf(size, 11 - exponent)) & 1023;
    return (uint16_t)(sign | (exponent + 14) << 10 | fraction);
}

void async_copy(void *shared, const void *global) {
    copies[current].push_back({shared, global, groups[current]});
}

void async_commit() {
    groups[current]++;
}

void async_wait_but(int newest) {
    std::vector<pending> &mine = copies[current], left;
    for (const pending &p : mine) {
        if (p.group < groups[current] - newest)
            memcpy(p.to, p.from, 16);
        else
            left.push_back(p);
    }
    mine = left;
}

/* ---- the part of CUDA's runtime ---- */
static size_t in_use;

/* Not a number in every type, until something writes there. */
void *device_take(context *c, size_t bytes) {
    const size_t rounded = (bytes + PAGE_BYTES - 1) / PAGE_BYTES * PAGE_BYTES;
    const bool room = !cuda_emulated_bytes || in_use + rounded <= cuda_emulated_bytes;
    region r;
    if (!room || !region_map(rounded, &r)) {
        failure(c, SHERF_NO_MEMORY, "out of GPU memory: %.1f MB requested, %.1f of %.1f MB are free",
                (double)bytes / 1e6, (double)(cuda_emulated_bytes - in_use) / 1e6,
                (double)cuda_emulated_bytes / 1e6);
        return nullptr;
    }
    memset(r.data, 0xff, rounded);
    in_use += rounded;
    regions.push_back(r);
    if (locked) mprotect(r.block, r.block_bytes, PROT_NONE);
    return r.data;
}

void device_give(void *p) {
    begin_work(); /* copies to it that are still due */
    lock_memory(true);
    for (size_t i = 0; i < regions.size(); i++)
        if (regions[i].data == p) {
            munmap(regions[i].mapping, regions[i].mapping_bytes);
            in_use -= regions[i].bytes;
            regions.erase(regions.begin() + (long)i);
            return;
        }
    broken("memory is given back that was not taken");
}

void *pinned_take(size_t bytes) {
    return malloc(bytes);
}

sherf_status copy_begin(context *c, copy_way way, void *to, const void *from, size_t bytes) {
    if (way == TO_DEVICE) {
        late.push_back({to, from, bytes});
        return SHERF_OK;
    }
    begin_work();
    memmove(to, from, bytes);
    lock_memory(true);
    return SHERF_OK;
}

sherf_status clear_begin(context *c, void *to, size_t bytes) {
    begin_work();
    memset(to, 0, bytes);
    lock_memory(true);
    return SHERF_OK;
}

sherf_status wait_for_all(context *c) {
    begin_work();
    lock_memory(true);
    return SHERF_OK;
}

struct mark {
    uint64_t at;
};

mark *mark_make() {
    return new mark();
}

void mark_set(mark *place) {
    place->at = late_done + late.size();
}

void mark_wait(mark *place) {
    copy_late(place->at);
    lock_memory(true);
}

sherf_status finished(context *c, const char *what) {
    lock_memory(true);
    return SHERF_OK;
}

sherf_status finished_work(context *c, const char *what) {
    lock_memory(true);
    return SHERF_OK;
}

int multiprocessors() {
    return 2;
}

void *pinned_take(context *c, size_t bytes) {
    return mem_alloc(c, bytes, 1);
}

void pinned_give(void *p) {
    mem_free(p);
}

/* ---- the part of this project's library ---- */
static float rounded(float v, bool bf16) {
    uint32_t bits;
    if (!bf16) return v;
    memcpy(&bits, &v, sizeof bits);
    bits = (bits + 0x7fff + (bits >> 16 & 1)) & 0xffff0000u;
    memcpy(&v, &bits, sizeof v);
    return v;
}

sherf_status product(op_call *call, const product_shape &s, const float *a, const float *b, float *y) {
    begin_work();
    for (int64_t m = 0; m < s.M; m++) {
        std::vector<float> row((size_t)s.N);
        for (int64_t k = 0; k < s.K; k++) {
            const float v = rounded(s.a_turned ? a[k * s.lda + m] : a[m * s.lda + k], call->bf16);
            const float *from = s.b_turned ? b + k : b + k * s.ldb;
            const int64_t step = s.b_turned ? s.ldb : 1;
            for (int64_t n = 0; n < s.N; n++) row[(size_t)n] += v * rounded(from[n * step], call->bf16);
        }
        for (int64_t n = 0; n < s.N; n++) {
            float *to = y + m * s.ldy + n;
            *to = s.alpha * row[(size_t)n] + (s.beta != 0 ? s.beta * *to : 0);
        }
    }
    return SHERF_OK;
}

} // namespace cuda_backend

int atomicAdd(int *to, int v) {
    const int was = *to;
    *to += v;
    return was;
}

void __syncthreads() {
    cuda_backend::wait(cuda_backend::AT_BLOCK);
}
