/* Encodings, norms and attention of one vector of points in float32, for frames and for training; for files
 * that define LANES. Channels are rows, `row` vectors apart. */
#ifndef SHERF_RADIANCE_FLOAT_TOKEN_H
#define SHERF_RADIANCE_FLOAT_TOKEN_H

#include <math.h>

#include "base/simd.h"
#include "model/sherf/fused/inside.h"

/* PE of component i: x, then sin(2^k x), cos(2^k x) over the three components; rows beyond `width` are
 * dropped. */
INLINE void encode_component(vf x, int i, int frequencies, int width, vf *out, int row) {
    if (i < width) out[i * row] = x;
    for (int k = 0; k < frequencies; k++) {
        const int sine = 3 + 6 * k + i, cosine = sine + 3;
        vf s, c;
        sincos_lanes(x * (float)(1 << k), &s, &c);
        if (sine < width) out[sine * row] = s;
        if (cosine < width) out[cosine * row] = c;
    }
}

/* ---- layer norm ---- */
typedef struct {
    vf mean, scale;
} moments;

INLINE moments moments_of(const vf *x, int width, int row) {
    moments stats = {splat(0), splat(0)};
    vf variance = splat(0);
    for (int i = 0; i < width; i++) stats.mean += x[i * row];
    stats.mean /= (float)width;
    for (int i = 0; i < width; i++) variance += (x[i * row] - stats.mean) * (x[i * row] - stats.mean);
    variance = variance / (float)width + 1e-5f;
    for (int i = 0; i < LANES; i++) stats.scale[i] = 1.0f / sqrtf(variance[i]);
    return stats;
}

INLINE void norm_vector(const vf *x, int width, const float *weight, const float *bias, vf *y, int row) {
    const moments stats = moments_of(x, width, row);
    for (int i = 0; i < width; i++)
        y[i * row] = (x[i * row] - stats.mean) * stats.scale * weight[i] + bias[i];
}

/* ---- attention ---- */
/* One head: qkv [3 tokens][q k v][heads][head_width] -> mixed [2 tokens][heads][head_width], from the head's
 * first row on; chance [2][3]: each token's attention weights, or NULL. The decoder reads only tokens 0 and
 * 1, so token 2 is only key and value. */
INLINE void attention_head(const radiance_field *n, const vf *qkv, vf *chance, vf *mixed, int row) {
    const int head = n->s.head_width, part = n->attention_width * row, token = 3 * part;
    const float scale = 1.0f / sqrtf((float)head);
    for (int i = 0; i < 2; i++) {
        vf dot[3] = {splat(0), splat(0), splat(0)}, sum = splat(0);
        for (int d = 0; d < head * row; d += row)
            for (int j = 0; j < 3; j++) dot[j] += qkv[i * token + d] * qkv[j * token + part + d];
        const vf top = max_lanes(max_lanes(dot[0], dot[1]), dot[2]);
        for (int j = 0; j < 3; j++) sum += dot[j] = exp_lanes((dot[j] - top) * scale);
        for (int j = 0; j < 3; j++) dot[j] /= sum;
        for (int j = 0; chance && j < 3; j++) chance[(3 * i + j) * row] = dot[j];
        for (int d = 0; d < head * row; d += row) {
            const vf *value = qkv + 2 * part + d;
            mixed[i * part + d] = dot[0] * value[0] + dot[1] * value[token] + dot[2] * value[2 * token];
        }
    }
}
#endif
