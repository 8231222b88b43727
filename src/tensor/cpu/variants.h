/* One loop compiled for every instruction set. The loop is written once as plain C,
 *     static VARIANT_BODY void name(void *arg, int64_t begin, int64_t end, int thread) { ... }
 *     VARIANTS(name)
 * and name_best() is the compilation that isa_best() allows, a range_function for parallel_for. */
#ifndef SHERF_CPU_VARIANTS_H
#define SHERF_CPU_VARIANTS_H

#include "base/base.h"

#define VARIANT_BODY inline __attribute__((always_inline))

#if defined(__x86_64__)
#define VARIANT(name, level, ...)                                                                            \
    __VA_ARGS__ static void name##_##level(void *arg, int64_t begin, int64_t end, int thread) {              \
        name(arg, begin, end, thread);                                                                       \
    }
#define VARIANTS(name)                                                                                       \
    VARIANT(name, plain)                                                                                     \
    VARIANT(name, avx2, __attribute__((target("avx2,fma"))))                                                 \
    VARIANT(name, avx512, __attribute__((target("avx2,fma,avx512f,avx512bw,avx512dq,avx512vl"))))            \
    static range_function name##_best(void) {                                                                \
        return ISA_CHOICE(isa_best(), name);                                                                 \
    }
#else
#define VARIANTS(name)                                                                                       \
    static range_function name##_best(void) {                                                                \
        return name;                                                                                         \
    }
#endif
#endif
