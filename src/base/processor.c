/* The CPU's level, by CPUID and the kernel's permission to use AMX; the clock and this process's peak memory.
 */
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "base/base.h"

#if defined(__x86_64__)
#include <cpuid.h>

/* Linux grants AMX tile state only on request: arch_prctl(ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA). */
static bool amx_permitted(void) {
    unsigned a, b, c, d;
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d)) return false;
    const unsigned needed = 1u << 22 | 1u << 23 | 1u << 24; /* AMX-BF16, AVX512-FP16, AMX-TILE */
    if ((d & needed) != needed) return false;
    return syscall(SYS_arch_prctl, 0x1023, 18) == 0;
}
#endif

static isa_level detect(void) {
#if defined(__x86_64__)
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma")) return ISA_PLAIN;
    if (!__builtin_cpu_supports("avx512f") || !__builtin_cpu_supports("avx512bw") ||
        !__builtin_cpu_supports("avx512vl") || !__builtin_cpu_supports("avx512dq"))
        return ISA_AVX2;
    unsigned a, b, c, d;
    if (!__get_cpuid_count(7, 1, &a, &b, &c, &d) || !(a & (1u << 5))) return ISA_AVX512; /* AVX512-BF16 */
    return amx_permitted() ? ISA_AMX : ISA_AVX512;
#elif defined(__aarch64__)
    return ISA_NEON; /* every aarch64 CPU has it */
#else
    return ISA_PLAIN;
#endif
}

static const char *const names[] = {"plain", "neon", "avx2", "avx512", "amx"};

/* Whether a level below the best one belongs to this CPU's architecture. */
static bool is_ours(int level) {
#if defined(__x86_64__)
    return level != ISA_NEON;
#else
    return true;
#endif
}

isa_level isa_best(void) {
    static atomic_int known = -1;
    int level = atomic_load(&known);
    if (level < 0) {
        level = (int)detect();
        atomic_store(&known, level);
    }
    const char *mask = getenv("SHERF_ISA");
    for (int i = 0; mask && i < level; i++)
        if (is_ours(i) && !strcmp(mask, names[i])) level = i;
    return (isa_level)level;
}

bool isa_has_bf16(void) {
    return isa_best() >= ISA_AMX;
}

const char *isa_name(isa_level level) {
    return names[level];
}

double time_seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

size_t memory_peak_bytes(void) {
    struct rusage u;
    return getrusage(RUSAGE_SELF, &u) ? 0 : (size_t)u.ru_maxrss * 1024;
}
