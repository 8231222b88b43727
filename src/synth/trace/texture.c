/* Textures: a pyramid of RGBA bytes. Averages use linear, opacity-weighted colour. */
#include <string.h>

#include "synth/trace/trace_inside.h"

enum { TEXTURE_SIDE_MAX = 16384, SHADOW_SIDE = 512, ENCODE_STEPS = 4096 };

float srgb_of_linear(float x) {
    return x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f;
}

static float linear_of_srgb(float x) {
    return x <= 0.04045f ? x / 12.92f : powf((x + 0.055f) / 1.055f, 2.4f);
}

/* Computes level n from level n - 1: the mean of 2 x 2 texels (of one if a side has only one). */
static void halve(trace_texture *t, int n, const uint8_t *encode) {
    const uint8_t *from = t->level[n - 1].texel;
    int w = t->level[n - 1].width, h = t->level[n - 1].height;
    uint8_t *to = t->level[n].texel;
    for (int y = 0; y < t->level[n].height; y++)
        for (int x = 0; x < t->level[n].width; x++, to += 4) {
            float sum[3] = {0}, plain[3] = {0};
            int opacity = 0;
            for (int i = 0; i < 4; i++) {
                int sx = 2 * x + (i & 1), sy = 2 * y + (i >> 1);
                const uint8_t *p =
                    from + 4 * ((size_t)(sy < h ? sy : h - 1) * (size_t)w + (size_t)(sx < w ? sx : w - 1));
                opacity += p[3];
                for (int k = 0; k < 3; k++) {
                    plain[k] += t->linear[p[k]];
                    sum[k] += t->linear[p[k]] * p[3];
                }
            }
            for (int k = 0; k < 3; k++) {
                float v = opacity ? sum[k] / (float)opacity : 0.25f * plain[k];
                to[k] = encode[(int)(v * (ENCODE_STEPS - 1) + 0.5f)];
            }
            to[3] = (uint8_t)((opacity + 2) / 4);
        }
}

static void expand(trace_texture *t, int channels, const uint8_t *data) {
    size_t n = (size_t)t->level[0].width * (size_t)t->level[0].height;
    uint8_t *to = t->level[0].texel;
    for (size_t i = 0; i < n; i++, to += 4, data += channels) {
        for (int k = 0; k < 3; k++) to[k] = data[channels == 1 ? 0 : k];
        to[3] = channels == 4 ? data[3] : 255;
        t->has_alpha |= to[3] < 255;
    }
}

sherf_status trace_texture_create(context *c, int width, int height, int channels, const uint8_t *data,
                                  trace_texture **out) {
    *out = NULL;
    if (width < 1 || width > TEXTURE_SIDE_MAX || height < 1 || height > TEXTURE_SIDE_MAX ||
        (channels != 1 && channels != 3 && channels != 4))
        return failure(c, SHERF_BAD_ARGUMENT, "texture: %d x %d with %d channels, sides must be 1 to %d",
                       width, height, channels, TEXTURE_SIDE_MAX);
    trace_texture *t = mem_zero(c, 1, sizeof *t);
    uint8_t *encode = mem_alloc(c, ENCODE_STEPS, 1), *texels = NULL;
    if (!t || !encode) goto fail;
    size_t total = 0;
    for (int w = width, h = height; t->levels < TEXTURE_LEVELS; w = (w + 1) / 2, h = (h + 1) / 2) {
        t->level[t->levels].width = w;
        t->level[t->levels++].height = h;
        total += (size_t)w * (size_t)h;
        if (w == 1 && h == 1) break;
    }
    if (!(texels = mem_alloc(c, total, 4))) goto fail;
    for (int i = 0; i < 256; i++) t->linear[i] = linear_of_srgb((float)i / 255);
    for (int i = 0; i < ENCODE_STEPS; i++)
        encode[i] = (uint8_t)(255 * srgb_of_linear((float)i / (ENCODE_STEPS - 1)) + 0.5f);
    for (int n = 0; n < t->levels; n++) {
        t->level[n].texel = texels;
        texels += 4 * (size_t)t->level[n].width * (size_t)t->level[n].height;
        if (n == 0)
            expand(t, channels, data);
        else
            halve(t, n, encode);
        if (t->level[n].width > SHADOW_SIDE || t->level[n].height > SHADOW_SIDE) t->shadow_level = n + 1;
    }
    if (t->shadow_level >= t->levels) t->shadow_level = t->levels - 1;
    mem_free(encode);
    *out = t;
    return SHERF_OK;
fail:
    mem_free(encode);
    mem_free(t);
    return SHERF_NO_MEMORY;
}

void trace_texture_free(trace_texture *t) {
    if (!t) return;
    mem_free(t->level[0].texel);
    mem_free(t);
}

/* The texel that contains the repeated coordinate x of `n`. Any float is fine. */
static int wrapped(float x, int n) {
    float whole = floorf(x);
    float in = x - whole; /* [0, 1], NaN for infinities */
    int i = in >= 0 ? (int)(in * (float)n) : 0;
    return i < n ? i : n - 1;
}

float texture_opacity(const trace_texture *t, const float uv[2]) {
    int n = t->shadow_level, w = t->level[n].width, h = t->level[n].height;
    int x = wrapped(uv[0], w), y = wrapped(1 - uv[1], h);
    return (float)t->level[n].texel[4 * ((size_t)y * (size_t)w + (size_t)x) + 3] * (1 / 255.0f);
}

float texture_min_opacity(const trace_texture *t, const float low_uv[2], const float high_uv[2]) {
    enum { TEXELS_MAX = 96 }; /* along a side */
    int min = 255, w = t->level[0].width, h = t->level[0].height;
    float x0 = floorf(low_uv[0] * (float)w) - 1, x1 = floorf(high_uv[0] * (float)w) + 1;
    float y0 = floorf((1 - high_uv[1]) * (float)h) - 1, y1 = floorf((1 - low_uv[1]) * (float)h) + 1;
    if (!t->has_alpha) return 1;
    if (!(x1 - x0 < TEXELS_MAX && y1 - y0 < TEXELS_MAX && fabsf(x0) < 1e6f && fabsf(y0) < 1e6f)) return 0;
    for (int y = (int)y0; y <= (int)y1 && min; y++)
        for (int x = (int)x0; x <= (int)x1; x++) {
            size_t column = (size_t)((x % w + w) % w), row = (size_t)((y % h + h) % h);
            int opacity = t->level[0].texel[4 * (row * (size_t)w + column) + 3];
            min = opacity < min ? opacity : min;
        }
    return (float)min / 255;
}

/* The two neighbours of a place between texel centres, and the second's weight. */
static void neighbours(float x, int n, int *a, int *b, float *weight) {
    float in = x - floorf(x);
    if (!(in >= 0)) in = 0;
    float at = in * (float)n - 0.5f, below = floorf(at);
    *weight = at - below;
    *a = (int)below;
    *b = *a + 1;
    if (*a < 0) *a = n - 1;
    if (*a >= n) *a = n - 1;
    if (*b >= n) *b = 0;
}

void texture_sample(const trace_texture *t, const float uv[2], float width_uv, float rgba[4]) {
    float texels = width_uv * sqrtf((float)t->level[0].width * (float)t->level[0].height);
    int n = texels > 1 ? ilogbf(texels * 1.41421356f) : 0;
    if (n < 0) n = 0;
    if (n >= t->levels) n = t->levels - 1;
    int w = t->level[n].width, h = t->level[n].height, x[2], y[2];
    float fx, fy;
    neighbours(uv[0], w, &x[0], &x[1], &fx);
    neighbours(1 - uv[1], h, &y[0], &y[1], &fy);
    for (int k = 0; k < 4; k++) rgba[k] = 0;
    for (int i = 0; i < 4; i++) {
        const uint8_t *p = t->level[n].texel + 4 * ((size_t)y[i >> 1] * (size_t)w + (size_t)x[i & 1]);
        float weight = (i & 1 ? fx : 1 - fx) * (i >> 1 ? fy : 1 - fy);
        float opaque = weight * (float)p[3] * (1 / 255.0f);
        if (t->has_alpha) weight = opaque;
        for (int k = 0; k < 3; k++) rgba[k] += weight * t->linear[p[k]];
        rgba[3] += opaque;
    }
    if (t->has_alpha && rgba[3] > 0)
        for (int k = 0; k < 3; k++) rgba[k] /= rgba[3];
}
