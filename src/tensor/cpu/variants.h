/* One loop compiled for every instruction set. The loop is written once as plain C,
 *     static VARIANT_BODY void name(void *arg, int64_t begin, int64_t end, int thread) { ... }
 *     VARIANTS(name)
 * and name_best() is the compilation that isa_best() allows, a range_function for parallel_for. */
#ifndef SHERF_CPU_VARIANTS_H
#define SHERF_CPU_VARIANTS_H

#include "base/base.h"

#define VARIANT_BODY inline __attribute__((always_inline))

#if defined(__x86_64__)
#define VARIANTS(name)                                                                                       \
    static void name##_plain(void *arg, int64_t begin, int64_t end, int thread) {                            \
        name(arg, begin, end, thread);                                                                       \
    }                                                                                                        \
    __attribute__((target("avx2,fma"))) static void name##_avx2(void *arg, int64_t begin, int64_t end,       \
                                                                int thread) {                                \
        name(arg, begin, end, thread);                                                                       \
    }                                                                                                        \
    __attribute__((target("avx2,fma,avx512f,avx512bw,avx512dq,avx512vl"))) static void name##_avx512(        \
        void *arg, int64_t begin, int64_t end, int thread) {                                                 \
        name(arg, begin, end, thread);                                                                       \
    }                                                                                                        \
    static range_function name##_best(void) {                                                                \
        const isa_level level = isa_best();                                                                  \
        return level >= ISA_AVX512 ? name##_avx512 : level >= ISA_AVX2 ? name##_avx2 : name##_plain;         \
    }
#else
#define VARIANTS(name)                                                                                       \
    static range_function name##_best(void) {                                                                \
        return name;                                                                                         \
    }
#endif
#endif
