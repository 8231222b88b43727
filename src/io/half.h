/* 16-bit floats to float32, exactly, and back to the nearest. */
#ifndef SHERF_HALF_H
#define SHERF_HALF_H

#include <stdint.h>
#include <string.h>

static inline float bf16_to_float(uint16_t h) {
    uint32_t bits = (uint32_t)h << 16;
    float f;
    memcpy(&f, &bits, sizeof f);
    return f;
}

/* IEEE binary16: 1 sign, 5 exponent (bias 15), 10 fraction bits. */
static inline float half_to_float(uint16_t h) {
    uint32_t sign = (uint32_t)(h & 0x8000u) << 16, exponent = (h >> 10) & 31u, fraction = h & 1023u;
    float f;
    if (exponent == 0) { /* zero and subnormals: fraction * 2^-24 */
        f = (float)fraction * 0x1p-24f;
        return sign ? -f : f;
    }
    uint32_t bits = sign | fraction << 13 | (exponent == 31 ? 255u << 23 : (exponent + 112) << 23);
    memcpy(&f, &bits, sizeof f);
    return f;
}

/* To the nearest, ties to even; too large values become infinite. */
static inline uint16_t half_from_float(float f) {
    uint32_t bits;
    memcpy(&bits, &f, sizeof bits);
    const uint32_t sign = bits >> 16 & 0x8000u, whole = bits & 0x7fffffffu;
    if (whole > 0x7f800000u) return (uint16_t)(sign | 0x7e00u); /* no number */
    if (whole >= 0x477ff000u) return (uint16_t)(sign | 0x7c00u);
    if (whole < 0x38800000u) { /* a multiple of 2^-24 below 2^-14; the addition rounds */
        float small, one = 0x1p-1f;
        memcpy(&small, &whole, sizeof small);
        small += one;
        uint32_t rounded;
        memcpy(&rounded, &small, sizeof rounded);
        return (uint16_t)(sign | (rounded - 0x3f000000u));
    }
    return (uint16_t)(sign | ((whole - 0x38000000u + 0xfffu + (whole >> 13 & 1)) >> 13));
}
#endif
