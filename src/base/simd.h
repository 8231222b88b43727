/* Vectors of LANES floats and elementary functions on them, for files that are compiled once for each
 * instruction set: define LANES (4, 8, 16) before the inclusion. Compilers lower them to the file's
 * instruction set. ISA_CHOICE (base.h) selects the variant for a CPU. */
#ifndef SHERF_SIMD_H
#define SHERF_SIMD_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline, unused))

typedef float vf __attribute__((vector_size(LANES * 4), may_alias));
typedef int32_t vi __attribute__((vector_size(LANES * 4), may_alias));
typedef uint32_t vu __attribute__((vector_size(LANES * 4), may_alias));
typedef float vf_any __attribute__((vector_size(LANES * 4), may_alias, aligned(4))); /* at any float */
typedef float v4 __attribute__((vector_size(16)));
typedef float v8 __attribute__((vector_size(32)));

INLINE vf splat(float x) {
    return x - (vf){0};
}
INLINE vf load(const float *p) {
    return *(const vf_any *)p;
}
INLINE void store(float *p, vf x) {
    *(vf_any *)p = x;
}
/* The first n of LANES floats, then zeros. */
INLINE vf load_some(const float *p, int64_t n) {
    float buffer[LANES] = {0};
    memcpy(buffer, p, (size_t)n * sizeof(float));
    return load(buffer);
}
INLINE void store_some(float *p, vf x, int64_t n) {
    float buffer[LANES];
    store(buffer, x);
    memcpy(p, buffer, (size_t)n * sizeof(float));
}
/* NUMBERS adjacent floats, each of which multiplies whole vectors. NEON multiplies by one lane of a vector,
 * so there one load brings four; elsewhere each is broadcast. */
#if defined(__aarch64__) && LANES == 4
enum { NUMBERS = 4 };
typedef vf numbers;
INLINE numbers numbers_load(const float *p) {
    return load(p);
}
INLINE vf number(numbers n, const int i) {
    return splat(n[i]);
}
#else
enum { NUMBERS = 1 };
typedef float numbers;
INLINE numbers numbers_load(const float *p) {
    return *p;
}
INLINE vf number(numbers n, const int i) {
    return splat(n);
}
#endif
INLINE vf choose(vi mask, vf yes, vf no) {
    return (vf)(((vi)yes & mask) | ((vi)no & ~mask));
}
INLINE vf max_lanes(vf a, vf b) {
    return choose(a > b, a, b);
}
INLINE vf min_lanes(vf a, vf b) {
    return choose(a < b, a, b);
}

/* Sums of four, eight, LANES neighbours, added pairwise. */
INLINE v4 halves(vf x) {
#if LANES == 16
    v8 h[2];
    memcpy(h, &x, sizeof x);
    v8 y = h[0] + h[1];
#else
    vf y = x;
#endif
#if LANES >= 8
    v4 q[2];
    memcpy(q, &y, sizeof y);
    return q[0] + q[1];
#else
    return y;
#endif
}
INLINE float sum_lanes(vf x) {
    const v4 q = halves(x);
    return (q[0] + q[2]) + (q[1] + q[3]);
}
/* The four sums as one vector. */
INLINE v4 sum_lanes_4(vf a, vf b, vf c, vf d) {
    const v4 p = halves(a), q = halves(b), r = halves(c), s = halves(d);
    const v4 pq = __builtin_shufflevector(p, q, 0, 4, 1, 5) + __builtin_shufflevector(p, q, 2, 6, 3, 7);
    const v4 rs = __builtin_shufflevector(r, s, 0, 4, 1, 5) + __builtin_shufflevector(r, s, 2, 6, 3, 7);
    return __builtin_shufflevector(pq, rs, 0, 1, 4, 5) + __builtin_shufflevector(pq, rs, 2, 3, 6, 7);
}

/* Nearest integer of |x| < 2^22, ties to even, by the float's own rounding: 1.5 x 2^23 + x has units in its
 * last place. So the lowest 22 bits of `bits` are the integer's, modulo 2^22; for NaN they are arbitrary,
 * while a conversion to an integer would be undefined. */
typedef struct {
    vf value;
    vu bits;
} rounded;
INLINE rounded round_lanes(vf x) {
    const vf magic = splat(12582912.0f), sum = x + magic;
    return (rounded){sum - magic, (vu)sum};
}

/* ---- exp ---- */
/* Within 1.2 units in the last place for -87 <= x <= 88, clamped to those ends; NaN stays. x = n ln(2) + r
 * with ln(2) in two parts, and exp(r) = 1 + r + r^2 P(r) for |r| <= ln(2) / 2. */
INLINE vf exp_lanes(vf x) {
    x = choose(x < -87.0f, splat(-87.0f), x);
    x = choose(x > 88.0f, splat(88.0f), x);
    const rounded n = round_lanes(x * 1.44269504f);
    const vf r = (x - n.value * 0.693115234375f) - n.value * 3.19461833e-5f;
    vf p = splat(0.0013836834f) * r + 0.00837482207f;
    p = p * r + 0.0416682261f;
    p = p * r + 0.166664201f;
    p = p * r + 0.499999921f;
    p = p * (r * r) + r + 1.0f;
    const vu exponent = (n.bits + 127) << 23;
    return p * (vf)exponent;
}

/* ---- sine and cosine ---- */
/* Both to 1e-7 for |x| < 8000, and at most 1 beyond; NaN stays. x = n pi/2 + r, |r| <= pi/4, with pi/2 in
 * three parts. */
INLINE void sincos_lanes(vf x, vf *sine, vf *cosine) {
    x = choose(x < -1e5f, splat(-1e5f), x);
    x = choose(x > 1e5f, splat(1e5f), x);
    const rounded turns = round_lanes(x * 0.636619772f);
    const vf n = turns.value;
    const vu quarter = turns.bits;
    const vi odd = -(vi)(quarter & 1);
    const vf r = ((x - n * 1.5703125f) - n * 4.83751297e-4f) - n * 7.54978942e-8f, u = r * r;
    const vf s = r + r * u * ((splat(-0.00019501822f) * u + 0.00833201645f) * u - 0.166666502f);
    vf c = (((splat(2.43726786e-05f) * u - 0.00138865291f) * u + 0.0416666132f) * u - 0.499999996f) * u;
    c += 1.0f;
    *sine = (vf)((vu)choose(odd, c, s) ^ ((quarter & 2) << 30));
    *cosine = (vf)((vu)choose(odd, s, c) ^ (((quarter + 1) & 2) << 30));
}
INLINE vf sin_lanes(vf x) {
    vf sine, cosine;
    sincos_lanes(x, &sine, &cosine);
    return sine;
}

/* ---- GELU, x Phi(x) ---- */
/* erfc(|z|) = exp(-z^2) t R(t), t = 1 / (1 + |z| / 2), given exp(-z^2): relative error 4e-7 (fit of
 * erfc(z) exp(z^2) / t for z < 23). */
INLINE vf erfc_lanes(vf z, vf exp_minus_square) {
    z = choose(z < 0.0f, -z, z);
    const vf t = 1.0f / (1.0f + 0.5f * z);
    vf p = splat(-0.00794037708f);
    p = p * t - 0.0195721241f;
    p = p * t + 0.20081202f;
    p = p * t - 0.388376417f;
    p = p * t + 0.207097265f;
    p = p * t + 0.00526194939f;
    p = p * t + 0.193824286f;
    p = p * t + 0.244550744f;
    p = p * t + 0.282252162f;
    p = p * t + 0.282090423f;
    return exp_minus_square * p * t;
}

/* Phi(-|x|) and exp(-x x / 2). */
typedef struct {
    vf tail, power;
} normal_tails;
INLINE normal_tails normal_lanes(vf x) {
    const vf power = exp_lanes(-0.5f * x * x);
    return (normal_tails){0.5f * erfc_lanes(x * 0.707106781f, power), power};
}

INLINE vf gelu_lanes(vf x) {
    const normal_tails n = normal_lanes(x);
    return choose(x < 0.0f, x * n.tail, x - x * n.tail);
}

/* Its derivative, Phi(x) + x phi(x). */
INLINE vf gelu_slope_lanes(vf x) {
    const normal_tails n = normal_lanes(x);
    return choose(x < 0.0f, n.tail, 1.0f - n.tail) + x * n.power * 0.398942280f;
}
#endif
