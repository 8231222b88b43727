/* base: the context every call carries, status and messages, memory, arenas, threads, random numbers.
 * Every function that can fail takes the context first and returns a sherf_status, or a pointer that is
 * NULL on failure; the context then holds one line that says what, where and why. */
#ifndef SHERF_BASE_H
#define SHERF_BASE_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus /* CUDA's sources */
#include <atomic>
using std::atomic_int;
extern "C" {
#else
#include <stdatomic.h>
#endif

#include "sherf/sherf.h"

/* For small functions shared by the CPU and GPU kernels. */
#ifdef __CUDACC__
#define HOST_AND_DEVICE __host__ __device__
#else
#define HOST_AND_DEVICE
#endif

typedef struct sherf_context context;

struct sherf_context {
    char message[1024];     /* the newest error, one line; empty: none */
    sherf_log_function log; /* may be NULL */
    sherf_progress_function progress;
    void *user;                /* passed to both */
    int threads;               /* worker threads of this context, at least 1 */
    sherf_precision precision; /* never AUTO: resolved when the context is made */
    sherf_device device;       /* never AUTO either */
    atomic_int cancelled;      /* set by sherf_cancel, polled by long loops */
};

/* ---- status and messages (status.c) ---- */
#define PRINTF_LIKE(f, a) __attribute__((format(printf, f, a)))
/* Stores the message and returns the status, so that `return failure(c, SHERF_BAD_FILE, ...)` reads well.
 * A newer message replaces an older one. */
sherf_status failure(context *c, sherf_status status, const char *format, ...) PRINTF_LIKE(3, 4);
/* Puts "prefix: " before the message: the level that knows the file's name adds it. */
sherf_status failure_prefix(context *c, sherf_status status, const char *format, ...) PRINTF_LIKE(3, 4);
void log_line(context *c, sherf_log_level level, const char *format, ...) PRINTF_LIKE(3, 4);
/* The precision of this context: bf16 if it is requested, or for AUTO, and the device has it. */
sherf_precision precision_resolve(const context *c, sherf_precision wanted);
/* done of total (total 0: unknown); text is a short noun phrase. Returns SHERF_CANCELLED once cancelled. */
sherf_status progress(context *c, const char *text, double done, double total);
bool cancelled(context *c);

/* ---- memory (memory.c) ----
 * All heap memory of the library comes from here, so that a test can fail every allocation in turn. */
void *mem_alloc(context *c, size_t count,
                size_t size); /* NULL and message on overflow or when out of memory; 64-byte aligned */
void *mem_zero(context *c, size_t count, size_t size); /* the same, zeroed */
void *mem_grow(context *c, void *old, size_t old_count, size_t count,
               size_t size); /* copy, free old on success */
char *mem_string(context *c, const char *text);
char *mem_format(context *c, const char *format, ...) PRINTF_LIKE(2, 3);
void mem_free(void *p); /* NULL is fine */
/* For tests: the n-th allocation from now (0 = the next) fails once; a negative n disables this. */
void mem_fail_after(long n);
long mem_count(void);  /* allocations so far in this process */
size_t mem_live(void); /* allocations not freed yet */
/* Whether the system would give this many bytes at once. Ask before calling libraries that crash without
 * memory. */
bool mem_room(size_t bytes);

/* An arena: bump allocation, reset in O(1). A reset merges its blocks into one of the size that was needed,
 * so a steady step allocates nothing. */
typedef struct arena arena;
typedef struct {
    size_t block, used;
} arena_mark;
/* The source of an arena's blocks. The arena treats them as plain addresses, so they may be a GPU's. */
typedef struct {
    void *(*take)(context *c, size_t bytes); /* NULL and message when out of memory; 64-byte aligned */
    void (*give)(void *p);
} memory_source;
arena *arena_create(context *c);
arena *arena_create_from(context *c, const memory_source *source); /* NULL: mem_alloc and mem_free */
void arena_free(arena *a);
void *arena_alloc(context *c, arena *a, size_t count, size_t size); /* 64-byte aligned, not zeroed */
arena_mark arena_position(const arena *a);
void arena_rewind(arena *a, arena_mark mark); /* memory taken since the mark is free again */
void arena_reset(arena *a);
size_t arena_peak(const arena *a); /* bytes */

/* ---- threads (threads.c): plain data parallelism over [0, n) in contiguous, fixed ranges ---- */
typedef void (*range_function)(void *arg, int64_t begin, int64_t end, int thread);
/* Splits [0, n) into at most `threads` ranges of at least `grain`; the split depends only on n, grain and the
 * thread count, so results are reproducible. */
void parallel_for(const context *c, int64_t n, int64_t grain, range_function f, void *arg);
int threads_available(void);
/* Starts the calling thread's threads now, all n or as many as the system gives, and returns their number:
 * OpenMP ends the process if it cannot start one later. */
int threads_make(int n);

/* ---- random numbers (random.c): counter-based, so any stream can be entered anywhere ---- */
uint64_t fnv1a64(const char *text);
uint64_t splitmix64(uint64_t x);
/* Value i of the stream `key`: u in [0, 1), 24 bits, splitmix64(key + i) >> 40 over 2^24. */
double random_uniform(uint64_t key, uint64_t i);
double random_normal(uint64_t key, uint64_t i); /* Box-Muller of values 2i and 2i + 1 */
uint64_t random_key(uint64_t seed, const char *stream, uint64_t index); /* one key of three parts */
int64_t random_below(uint64_t key, uint64_t i, int64_t n);              /* integer in [0, n) */

/* ---- processor (processor.c) ---- */
typedef enum { ISA_PLAIN, ISA_NEON, ISA_AVX2, ISA_AVX512, ISA_AMX } isa_level;
/* The best level of this machine (NEON is aarch64's, the others are x86-64's; AMX means AVX-512 with BF16 and
 * FP16, and AMX tiles that the kernel permits), lowered by SHERF_ISA=plain|neon|avx2|avx512|amx to another
 * level of this machine. */
isa_level isa_best(void);
bool isa_has_bf16(void); /* isa_best() has products in bf16: AMX */
const char *isa_name(isa_level level);
/* Chooses among the variants of a file that is compiled once for each instruction set, NAME_plain, NAME_neon,
 * NAME_avx2, NAME_avx512, the one for a level; NAME may begin with &. ISA_CHOICE_X86: without a NAME_neon. */
#if defined(__x86_64__)
#define ISA_CHOICE(level, NAME)                                                                              \
    ((level) >= ISA_AVX512 ? NAME##_avx512 : (level) >= ISA_AVX2 ? NAME##_avx2 : NAME##_plain)
#define ISA_CHOICE_X86(level, NAME) ISA_CHOICE(level, NAME)
#elif defined(__aarch64__)
#define ISA_CHOICE(level, NAME) ((level) >= ISA_NEON ? NAME##_neon : NAME##_plain)
#define ISA_CHOICE_X86(level, NAME) (NAME##_plain)
#else
#define ISA_CHOICE(level, NAME) (NAME##_plain)
#define ISA_CHOICE_X86(level, NAME) (NAME##_plain)
#endif

double time_seconds(void);      /* monotonic */
size_t memory_peak_bytes(void); /* peak resident set of this process */

#define COUNT_OF(a) (sizeof(a) / sizeof((a)[0]))

#ifdef __cplusplus
}
#endif
#endif
