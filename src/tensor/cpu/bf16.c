/* float32 to bf16, to nearest even, by AVX512-BF16's conversion, 32 values at a time. */
#include "tensor/cpu/bf16.h"

#include <string.h>

typedef struct {
    const float *from;
    uint16_t *to;
} rounding;

#if defined(__x86_64__)
#include <immintrin.h>

__attribute__((target("avx512f,avx512bw,avx512vl,avx512bf16"))) static void
round_range(void *arg, int64_t begin, int64_t end, int thread) {
    const rounding *r = arg;
    int64_t i = begin;
    for (; i + 32 <= end; i += 32) {
        __m512bh v = _mm512_cvtne2ps_pbh(_mm512_loadu_ps(r->from + i + 16), _mm512_loadu_ps(r->from + i));
        _mm512_storeu_si512(r->to + i, (__m512i)v);
    }
    for (; i < end; i += 16) {
        const __mmask16 rest = end - i >= 16 ? 0xffff : (__mmask16)((1 << (end - i)) - 1);
        __m256bh v = _mm512_cvtneps_pbh(_mm512_maskz_loadu_ps(rest, r->from + i));
        _mm256_mask_storeu_epi16(r->to + i, rest, (__m256i)v);
    }
}

#else
static void round_range(void *arg, int64_t begin, int64_t end, int thread) {
    const rounding *r = arg;
    for (int64_t i = begin; i < end; i++) {
        uint32_t bits;
        memcpy(&bits, r->from + i, sizeof bits);
        const bool nan = (bits & 0x7fffffff) > 0x7f800000;
        r->to[i] = (uint16_t)(nan ? bits >> 16 | 0x40 : (bits + 0x7fff + (bits >> 16 & 1)) >> 16);
    }
}
#endif

void bf16_round(const context *c, const float *from, uint16_t *to, int64_t n) {
    parallel_for(c, n, 1 << 14, round_range, &(rounding){from, to});
}
