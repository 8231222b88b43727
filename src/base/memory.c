/* The heap, which counts allocations and fails them for tests, and arenas on it or on another source. Large
 * blocks use huge pages. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

#include "base/base.h"

static atomic_long fail_countdown = -1;
static atomic_long allocations;
static atomic_long live;

void mem_fail_after(long n) {
    atomic_store(&fail_countdown, n);
}
long mem_count(void) {
    return atomic_load(&allocations);
}
size_t mem_live(void) {
    return (size_t)atomic_load(&live);
}

bool mem_room(size_t bytes) {
    void *p = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (p == MAP_FAILED) return false;
    munmap(p, bytes);
    return true;
}

static bool told_to_fail(void) {
    long n = atomic_load(&fail_countdown);
    while (n >= 0)
        if (atomic_compare_exchange_weak(&fail_countdown, &n, n - 1)) return n == 0;
    return false;
}

static const size_t huge_page = (size_t)2 << 20;

static void *allocate_plain(size_t bytes) {
    size_t rounded = (bytes + 63) / 64 * 64;
    return aligned_alloc(64, rounded ? rounded : 64);
}

/* Large blocks request huge pages: touching a gigabyte of arena for the first time costs 500 page faults
 * instead of 260,000, which was a quarter of the time of an avatar. */
static void *allocate_huge(size_t bytes) {
    size_t rounded = (bytes + huge_page - 1) / huge_page * huge_page;
    void *p = aligned_alloc(huge_page, rounded);
    if (p) madvise(p, rounded, MADV_HUGEPAGE);
    return p;
}

static void *allocate(context *c, size_t count, size_t size) {
    size_t bytes;
    if (__builtin_mul_overflow(count, size, &bytes) || bytes > SIZE_MAX / 2) {
        failure(c, SHERF_NO_MEMORY, "out of memory: %zu x %zu bytes is too much", count, size);
        return NULL;
    }
    atomic_fetch_add(&allocations, 1);
    void *p = told_to_fail() ? NULL : bytes >= 2 * huge_page ? allocate_huge(bytes) : allocate_plain(bytes);
    if (!p)
        failure(c, SHERF_NO_MEMORY, "out of memory: %zu bytes requested", bytes);
    else
        atomic_fetch_add(&live, 1);
    return p;
}

void *mem_alloc(context *c, size_t count, size_t size) {
    return allocate(c, count, size);
}

void *mem_zero(context *c, size_t count, size_t size) {
    void *p = allocate(c, count, size);
    if (p) memset(p, 0, count * size);
    return p;
}

void *mem_grow(context *c, void *old, size_t old_count, size_t count, size_t size) {
    void *p = allocate(c, count, size);
    if (!p) return NULL;
    size_t keep = old_count < count ? old_count : count;
    if (old && keep) memcpy(p, old, keep * size);
    mem_free(old);
    return p;
}

void mem_free(void *p) {
    if (!p) return;
    atomic_fetch_sub(&live, 1);
    free(p);
}

char *mem_string(context *c, const char *text) {
    size_t n = strlen(text) + 1;
    char *p = mem_alloc(c, n, 1);
    if (p) memcpy(p, text, n);
    return p;
}

char *mem_format(context *c, const char *format, ...) {
    va_list args, again;
    va_start(args, format);
    va_copy(again, args);
    int n = vsnprintf(NULL, 0, format, args);
    va_end(args);
    char *p = n < 0 ? NULL : mem_alloc(c, (size_t)n + 1, 1);
    if (p) vsnprintf(p, (size_t)n + 1, format, again);
    va_end(again);
    return p;
}

/* ---- arena ---- */
enum { ARENA_BLOCKS = 64 };
static const size_t arena_first_block = (size_t)1 << 20;

struct arena {
    memory_source source;
    size_t blocks; /* in use or kept */
    size_t current;
    struct {
        char *data;
        size_t size, used;
    } block[ARENA_BLOCKS];
    size_t taken_before; /* bytes used in blocks before the current one */
    size_t peak;
};

static void *heap_take(context *c, size_t bytes) {
    return mem_alloc(c, bytes, 1);
}

arena *arena_create_from(context *c, const memory_source *source) {
    arena *a = mem_zero(c, 1, sizeof *a);
    if (a) a->source = source ? *source : (memory_source){heap_take, mem_free};
    return a;
}

arena *arena_create(context *c) {
    return arena_create_from(c, NULL);
}

void arena_free(arena *a) {
    if (!a) return;
    for (size_t i = 0; i < a->blocks; i++) a->source.give(a->block[i].data);
    mem_free(a);
}

void *arena_alloc(context *c, arena *a, size_t count, size_t size) {
    size_t bytes;
    if (__builtin_mul_overflow(count, size, &bytes) || bytes > SIZE_MAX / 2) {
        failure(c, SHERF_NO_MEMORY, "out of memory: %zu x %zu bytes is too much", count, size);
        return NULL;
    }
    bytes = (bytes + 63) / 64 * 64;
    if (!bytes) bytes = 64;
    while (a->current < a->blocks && a->block[a->current].used + bytes > a->block[a->current].size) {
        if (a->current + 1 >= a->blocks) break;
        a->taken_before += a->block[a->current].used;
        a->current++;
        a->block[a->current].used = 0;
    }
    if (!a->blocks || a->block[a->current].used + bytes > a->block[a->current].size) {
        if (a->blocks == ARENA_BLOCKS) {
            failure(c, SHERF_NO_MEMORY, "out of memory: arena has too many blocks");
            return NULL;
        }
        size_t last = a->blocks ? a->block[a->blocks - 1].size : arena_first_block / 2;
        size_t want = last * 2 > bytes ? last * 2 : bytes;
        if (want > bytes && want > ((size_t)256 << 20))
            want = bytes > ((size_t)256 << 20) ? bytes : (size_t)256 << 20;
        char *data = a->source.take(c, want);
        if (!data) return NULL;
        if (a->blocks) a->taken_before += a->block[a->current].used;
        a->current = a->blocks++;
        a->block[a->current].data = data;
        a->block[a->current].size = want;
        a->block[a->current].used = 0;
    }
    char *p = a->block[a->current].data + a->block[a->current].used;
    a->block[a->current].used += bytes;
    size_t taken = a->taken_before + a->block[a->current].used;
    if (taken > a->peak) a->peak = taken;
    return p;
}

arena_mark arena_position(const arena *a) {
    return (arena_mark){a->current, a->blocks ? a->block[a->current].used : 0};
}

void arena_rewind(arena *a, arena_mark mark) {
    if (!a->blocks) return;
    while (a->current > mark.block) {
        a->block[a->current].used = 0;
        a->current--;
        a->taken_before -= a->block[a->current].used;
    }
    a->block[a->current].used = mark.used;
}

void arena_reset(arena *a) {
    if (a->blocks > 1) { /* one block for everything next time; the next arena_alloc makes it */
        size_t total = 0;
        for (size_t i = 0; i < a->blocks; i++) total += a->block[i].size;
        size_t want = a->peak + a->peak / 16 + 4096;
        for (size_t i = 0; i < a->blocks; i++) a->source.give(a->block[i].data);
        a->blocks = 0;
        context quiet = {0};
        char *data = a->source.take(&quiet, want < total ? want : total);
        if (data) {
            a->blocks = 1;
            a->block[0].data = data;
            a->block[0].size = want < total ? want : total;
        }
    }
    a->current = 0;
    a->taken_before = 0;
    if (a->blocks) a->block[0].used = 0;
}

size_t arena_peak(const arena *a) {
    return a->peak;
}
