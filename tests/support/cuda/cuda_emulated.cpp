#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <ucontext.h>
#include <vector>

#include "tensor/cuda/cuda.h"
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

namespace cuda_backend {

/* ---- fibres ---- */
enum { STACK_BYTES = 128 << 10, THREADS_MOST = 1024 };
enum thread_state { FRESH, READY, AT_WARP, AT_BLOCK, DONE };

struct fibre {
    ucontext_t place;
    const void *stack;
    size_t stack_bytes;
    void *watched; /* by the address sanitizer */
};

struct thread {
    thread_state state;
    fibre *on; /* where it stopped at a barrier */
    float value, lanes[WARP];
};

static std::vector<fibre *> idle;
static thread threads[THREADS_MOST];
static int thread_count, fresh_count, current; /* fresh: not begun yet */
static const std::function<void()> *kernel_body;
static fibre scheduler, *running;

[[noreturn]] static void broken(const char *what) {
    fprintf(stderr, "emulated kernel: %s\n", what);
    abort();
}

/* On a fibre again, after the scheduler; or on the scheduler, whose own stack is known then. */
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
    swapcontext(&from->place, &to->place);
    changed(from);
}

static void step_into(int i) {
    current = i;
    threadIdx = dim3(i % blockDim.x, i / blockDim.x % blockDim.y, i / blockDim.x / blockDim.y);
}

/* The next thread in the order that is asked for. */
static int fresh_take() {
    const int i = cuda_emulated_order ? fresh_count - 1 : thread_count - fresh_count;
    fresh_count--;
    return i;
}

/* A fibre runs threads one after another until one stops at a barrier; so kernels without barriers need one.
 */
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

/* Lets the threads [begin, end) go on when all that are not done stand at the barrier. */
static bool release(int begin, int end, thread_state barrier) {
    int waiting = 0;
    for (int i = begin; i < end; i++) {
        if (threads[i].state == DONE) continue;
        if (threads[i].state != barrier) return false;
        waiting++;
    }
    if (!waiting) return false;
    if (barrier == AT_WARP && waiting < WARP) broken("not all lanes of a warp come to warp_sum");
    for (int i = begin; i < end && barrier == AT_WARP; i++)
        for (int lane = 0; lane < end - begin; lane++) threads[i].lanes[lane] = threads[begin + lane].value;
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
        if (!left) return;
        if (!release_any()) broken("its threads wait at different barriers");
    }
}

/* ---- memory: locked from an op's end to the next launch or copy ---- */
struct region {
    char *data;
    size_t bytes;
};
static std::vector<region> regions;

static bool locked = true;

static void lock_memory(bool lock) {
    if (lock == locked) return;
    locked = lock;
    for (const region &r : regions) mprotect(r.data, r.bytes, lock ? PROT_NONE : PROT_READ | PROT_WRITE);
}

void emulate(dim3 grid, dim3 block, const std::function<void()> &body) {
    thread_count = (int)(block.x * block.y * block.z);
    if (thread_count < 1 || thread_count > THREADS_MOST || grid.x < 1 || grid.y < 1 || grid.y > 65535)
        broken("a launch of a size that no GPU takes");
    lock_memory(false);
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

float warp_sum(float v) {
    threads[current].value = v;
    wait(AT_WARP);
    float sum[WARP], next[WARP];
    memcpy(sum, threads[current].lanes, sizeof sum);
    for (int step = WARP / 2; step > 0; step /= 2) {
        for (int lane = 0; lane < WARP; lane++) next[lane] = sum[lane] + sum[lane ^ step];
        memcpy(sum, next, sizeof sum);
    }
    return sum[threadIdx.x % WARP];
}

/* Not a number in every type, until somebody writes. */
static void *take(context *c, size_t bytes) {
    const size_t rounded = (bytes + 4095) / 4096 * 4096;
    void *p = mmap(nullptr, rounded, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (p == MAP_FAILED) {
        failure(c, SHERF_NO_MEMORY, "out of emulated GPU memory: %zu bytes asked for", bytes);
        return nullptr;
    }
    memset(p, 0xff, rounded);
    regions.push_back({(char *)p, rounded});
    if (locked) mprotect(p, rounded, PROT_NONE);
    return p;
}

static void give(void *p) {
    for (size_t i = 0; i < regions.size(); i++)
        if (regions[i].data == p) {
            munmap(p, regions[i].bytes);
            regions.erase(regions.begin() + (long)i);
            return;
        }
    broken("memory is given back that was not taken");
}

static sherf_status move(context *c, void *to, const void *from, size_t bytes) {
    lock_memory(false);
    memmove(to, from, bytes);
    lock_memory(true);
    return SHERF_OK;
}

static sherf_status clear(context *c, void *to, size_t bytes) {
    lock_memory(false);
    memset(to, 0, bytes);
    lock_memory(true);
    return SHERF_OK;
}

const tensor_memory device_memory = {"emulated CUDA", {take, give}, move, move, move, clear};

sherf_status finished(op_call *call) {
    lock_memory(true);
    return SHERF_OK;
}

/* ---- the library's part ---- */
static float rounded(float v, bool bf16) {
    uint32_t bits;
    if (!bf16) return v;
    memcpy(&bits, &v, sizeof bits);
    bits = (bits + 0x7fff + (bits >> 16 & 1)) & 0xffff0000u;
    memcpy(&v, &bits, sizeof v);
    return v;
}

sherf_status product(op_call *call, const product_shape &s, const float *a, const float *b, float *y) {
    lock_memory(false);
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

void __syncthreads() {
    cuda_backend::wait(cuda_backend::AT_BLOCK);
}
