/* Vectors of LANES floats and elementary functions on them, for files that are compiled once per instruction
 * set: define LANES (4, 8, 16) before the inclusion. Compilers lower them to the instructions that the file
 * is compiled for. ISA_CHOICE (base.h) takes the file for a processor. The ops and the fused radiance field
 * have polynomials of their own, each with the error given: pictures and trainings are the same bits as those
 * that were measured. */
#ifndef SHERF_SIMD_H
#define SHERF_SIMD_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#define INLINE static inline __attribute__((always_inline, unused))

typedef float vf __attribute__((vector_size(LANES * 4), may_alias));
typedef int32_t vi __attribute__((vector_size(LANES * 4), may_alias));
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
/* The first n of LANES floats, zeros behind them. */
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

/* Nearest integer of |x| < 2^22, ties to even, by the float's own rounding. */
INLINE vf round_lanes(vf x) {
    const vf magic = splat(12582912.0f);
    return (x + magic) - magic;
}

/* ---- exp ---- */
/* ln(2) in two parts, and exp(r) = 1 + r + r^2 P(r) for |r| <= ln(2) / 2. */
typedef struct {
    float high, low, c[5];
} exp_fit;
INLINE vf exp_by(vf x, const exp_fit *f) {
    const vf n = round_lanes(x * 1.44269504f);
    const vf r = (x - n * f->high) - n * f->low;
    vf p = splat(f->c[0]);
    for (int i = 1; i < 5; i++) p = p * r + f->c[i];
    p = p * (r * r) + r + 1.0f;
    const vi exponent = (__builtin_convertvector(n, vi) + 127) << 23;
    return p * (vf)exponent;
}

/* 2 units in the last place for -87 <= x <= 88, clamped to those ends; not-a-number stays. */
INLINE vf exp_lanes(vf x) {
    static const exp_fit fit = {0.693115234375f,
                                3.19461833e-5f,
                                {0.0013836834f, 0.00837482207f, 0.0416682261f, 0.166664201f, 0.499999921f}};
    x = choose(x < -87.0f, splat(-87.0f), x);
    x = choose(x > 88.0f, splat(88.0f), x);
    return exp_by(x, &fit);
}

/* The same in the radiance field, where not-a-number becomes the lower end. */
INLINE vf exp_tile(vf x) {
    static const exp_fit fit = {0.693359375f,
                                -2.12194440e-4f,
                                {0.0013950243f, 0.0083688858f, 0.041666209f, 0.1666651887f, 0.5000000094f}};
    return exp_by(min_lanes(max_lanes(x, splat(-87.0f)), splat(88.0f)), &fit);
}

/* ---- sine and cosine ---- */
/* x = n pi/2 + r, |r| <= pi/4, with pi/2 in three parts; |x| < 8000. */
INLINE vf quarter_turn(vf x, vi *n) {
    const vf turns = round_lanes(x * 0.636619772f);
    *n = __builtin_convertvector(turns, vi);
    return ((x - turns * 1.5703125f) - turns * 4.83751297e-4f) - turns * 7.54978942e-8f;
}

/* sin to 1e-7 for |x| < 8000. */
INLINE vf sin_lanes(vf x) {
    vi n;
    const vf r = quarter_turn(x, &n), u = r * r;
    const vf s = r + r * u * ((splat(-0.00019501822f) * u + 0.00833201645f) * u - 0.166666502f);
    const vf c = (((splat(2.43726786e-05f) * u - 0.00138865291f) * u + 0.0416666132f) * u - 0.499999996f) * u;
    const vf v = choose(-(n & 1), c + 1.0f, s);
    return (vf)((vi)v ^ ((n & 2) << 30));
}

/* sin and cos to 1e-7 for |x| < 1e4 in the radiance field. */
INLINE void sincos_tile(vf x, vf *sine, vf *cosine) {
    vi n;
    const vf r = quarter_turn(min_lanes(max_lanes(x, splat(-1e5f)), splat(1e5f)), &n), u = r * r;
    const vf s = r + r * u * ((splat(-0.0001949564f) * u + 0.0083319787f) * u - 0.1666665067f);
    vf c = (splat(2.4438451404e-05f) * u - 1.3887367514e-03f) * u + 4.1666646866e-02f;
    c = 1.0f - 0.5f * u + u * u * c;
    const vi odd = -(n & 1);
    *sine = (vf)((vi)choose(odd, c, s) ^ ((n & 2) << 30));
    *cosine = (vf)((vi)choose(odd, s, c) ^ (((n + 1) & 2) << 30));
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

/* The same in the radiance field, by Abramowitz and Stegun 7.1.26: absolute error 0.75e-7. */
INLINE normal_tails normal_tile(vf x) {
    const vf a = choose(x < 0.0f, -x, x), z = min_lanes(a * 0.707106781f, splat(9.0f));
    const vf t = 1.0f / (1.0f + 0.3275911f * z);
    vf p = splat(1.061405429f) * t + -1.453152027f;
    p = p * t + 1.421413741f;
    p = p * t + -0.284496736f;
    p = p * t + 0.254829592f;
    const vf power = exp_tile(-(z * z));
    return (normal_tails){0.5f * t * p * power, power};
}

INLINE vf gelu_by(vf x, normal_tails n) {
    return choose(x < 0.0f, x * n.tail, x - x * n.tail);
}
INLINE vf gelu_lanes(vf x) {
    return gelu_by(x, normal_lanes(x));
}
INLINE vf gelu_tile(vf x) {
    return gelu_by(x, normal_tile(x));
}

/* Its derivative, Phi(x) + x phi(x). */
INLINE vf gelu_slope_by(vf x, normal_tails n) {
    return choose(x < 0.0f, n.tail, 1.0f - n.tail) + x * n.power * 0.398942280f;
}
INLINE vf gelu_slope_lanes(vf x) {
    return gelu_slope_by(x, normal_lanes(x));
}
INLINE vf gelu_slope_tile(vf x) {
    return gelu_slope_by(x, normal_tile(x));
}
#endif
