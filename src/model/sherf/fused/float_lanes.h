/* Vectors of LANES floats, which the including file defines, and what is computed with them: exp, sine and
 * cosine, the normal distribution. Compilers lower them to the instructions that the file is compiled for. */
#ifndef SHERF_RADIANCE_FLOAT_LANES_H
#define SHERF_RADIANCE_FLOAT_LANES_H

#include <math.h>
#include <stdint.h>

typedef float vf __attribute__((vector_size(LANES * 4), may_alias));
typedef int32_t vi __attribute__((vector_size(LANES * 4), may_alias));
typedef float vf_any __attribute__((vector_size(LANES * 4), may_alias, aligned(4)));

static inline vf splat(float x) {
    return x - (vf){0};
}
static inline vf choose(vi mask, vf yes, vf no) {
    return (vf)(((vi)yes & mask) | ((vi)no & ~mask));
}
static inline vf vmax(vf a, vf b) {
    return choose(a > b, a, b);
}
static inline vf vmin(vf a, vf b) {
    return choose(a < b, a, b);
}

/* Nearest integer of |x| < 2^22, ties to even, by the float's own rounding. */
static inline vf vround(vf x) {
    const vf magic = splat(12582912.0f);
    return (x + magic) - magic;
}

/* exp to 2 units in the last place; arguments are clamped to where the result is normal. */
static inline vf vexp(vf x) {
    x = vmin(vmax(x, splat(-87.0f)), splat(88.0f));
    vf n = vround(x * 1.44269504f);
    vf r = x - n * 0.693359375f;
    r = r - n * -2.12194440e-4f;
    vf p = splat(0.0013950243f);
    p = p * r + 0.0083688858f;
    p = p * r + 0.041666209f;
    p = p * r + 0.1666651887f;
    p = p * r + 0.5000000094f;
    p = p * (r * r) + r + 1.0f;
    vi e = (__builtin_convertvector(n, vi) + 127) << 23;
    return p * (vf)e;
}

/* sin and cos to 1e-7 for |x| < 1e4: x = n pi/2 + r with pi/2 in three parts, |r| <= pi/4. */
static inline void vsincos(vf x, vf *s, vf *c) {
    x = vmin(vmax(x, splat(-1e5f)), splat(1e5f));
    vf n = vround(x * 0.636619772f);
    vf r = x - n * 1.5703125f;
    r = r - n * 4.83751297e-4f;
    r = r - n * 7.54978942e-8f;
    vf u = r * r;
    vf ps = (splat(-0.0001949564f) * u + 0.0083319787f) * u + -0.1666665067f;
    ps = r + r * u * ps;
    vf pc = (splat(2.4438451404e-05f) * u + -1.3887367514e-03f) * u + 4.1666646866e-02f;
    pc = 1.0f - 0.5f * u + u * u * pc;
    vi q = __builtin_convertvector(n, vi);
    vi odd = -(q & 1);
    vf sv = choose(odd, pc, ps), cv = choose(odd, ps, pc);
    *s = (vf)((vi)sv ^ ((q & 2) << 30));
    *c = (vf)((vi)cv ^ (((q + 1) & 2) << 30));
}

/* Phi(-|x|) of the normal distribution, by Abramowitz and Stegun 7.1.26: absolute error 0.75e-7. *power:
 * exp(-x x / 2). */
static inline vf normal_tail(vf x, vf *power) {
    vf a = choose(x < 0.0f, -x, x);
    vf z = vmin(a * 0.707106781f, splat(9.0f));
    vf t = 1.0f / (1.0f + 0.3275911f * z);
    vf p = splat(1.061405429f) * t + -1.453152027f;
    p = p * t + 1.421413741f;
    p = p * t + -0.284496736f;
    p = p * t + 0.254829592f;
    *power = vexp(-(z * z));
    return 0.5f * t * p * *power;
}

/* x Phi(x) */
static inline vf vgelu(vf x) {
    vf power, tail = normal_tail(x, &power);
    return choose(x < 0.0f, x * tail, x - x * tail);
}

/* its derivative, Phi(x) + x phi(x) */
static inline vf vgelu_slope(vf x) {
    vf power, tail = normal_tail(x, &power);
    return choose(x < 0.0f, tail, 1.0f - tail) + x * power * 0.398942280f;
}

#endif
