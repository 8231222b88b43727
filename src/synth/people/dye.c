/* Dyes textures: patterns in space, combined with the folds in a texture. */
#include "synth/people/dye.h"

#include <math.h>
#include <string.h>

static float clamp(float x, float low, float high) {
    return x < low ? low : x > high ? high : x;
}

static float smooth(float low, float high, float x) {
    x = clamp((x - low) / (high - low), 0, 1);
    return x * x * (3 - 2 * x);
}

/* Distance from the middle of the nearest period, in periods: 0 to 0.5. */
static float from_middle(float x) {
    return fabsf(x - floorf(x) - 0.5f);
}

/* Soft 1 inside |x| < half, in units of a period; edges about a texel wide. */
static float band(float x, float ratio) {
    return smooth(0.5f * ratio + 0.03f, 0.5f * ratio - 0.03f, from_middle(x));
}

static float lattice(uint64_t key, int x, int y, int z) {
    uint64_t i = ((uint64_t)(uint32_t)x * 73856093u) ^ ((uint64_t)(uint32_t)y * 19349663u) ^
                 ((uint64_t)(uint32_t)z * 83492791u);
    return (float)random_uniform(key, i);
}

static float value_noise(uint64_t key, const float p[3]) {
    float f[3], w[3], sum = 0;
    int cell[3];
    for (int k = 0; k < 3; k++) {
        f[k] = floorf(p[k]);
        cell[k] = (int)clamp(f[k], -1e6f, 1e6f);
        w[k] = smooth(0, 1, p[k] - f[k]);
    }
    for (int i = 0; i < 8; i++) {
        float weight = 1;
        for (int k = 0; k < 3; k++) weight *= i >> k & 1 ? w[k] : 1 - w[k];
        sum += weight * lattice(key, cell[0] + (i & 1), cell[1] + (i >> 1 & 1), cell[2] + (i >> 2 & 1));
    }
    return sum;
}

void dye_shares(const dye_recipe *r, const dye_part *part, const float place[3], float *second,
                float *third) {
    /* `across` runs round the body, so neither front and back nor the sides are stretched much */
    float scale = r->scale_m > 1e-3f ? r->scale_m : 1e-3f;
    float across = (0.8f * place[0] + 0.6f * place[2]) / scale, up = place[1] / scale;
    float phase = (float)random_uniform(r->key, 1);
    float a = 0, b = 0;
    switch (r->pattern) {
    case DYE_BANDS:
        a = band(up + phase, r->ratio);
        break;
    case DYE_STRIPES:
        a = band(across + phase, r->ratio);
        break;
    case DYE_CHECKS:
        a = ((int)floorf(across + phase) + (int)floorf(up + phase)) & 1 ? 1.0f : 0.0f;
        break;
    case DYE_PLAID:
        a = 0.5f * band(across + phase, r->ratio) + 0.5f * band(up + phase, r->ratio);
        b = band(up + phase + 0.3f, 0.12f) * 0.7f;
        if (b < band(across + phase + 0.3f, 0.12f) * 0.7f) b = band(across + phase + 0.3f, 0.12f) * 0.7f;
        break;
    case DYE_DOTS: {
        float row = floorf(up), x = from_middle(across + phase + 0.5f * (row - 2 * floorf(row / 2))),
              y = from_middle(up), radius = 0.15f + 0.3f * r->ratio;
        a = smooth(radius + 0.05f, radius - 0.05f, sqrtf(x * x + y * y));
        break;
    }
    case DYE_GRADIENT: {
        float t = (place[1] - part->low[1]) / fmaxf(part->high[1] - part->low[1], 0.01f);
        a = smooth(r->ratio - 0.4f, r->ratio + 0.4f, t);
        break;
    }
    case DYE_HALVES: {
        float middle = part->low[1] + r->ratio * (part->high[1] - part->low[1]);
        a = phase < 0.4f ? smooth(-0.003f, 0.003f, place[0]) : smooth(-0.003f, 0.003f, place[1] - middle);
        if (phase > 0.6f) b = smooth(0.012f, 0.006f, fabsf(place[1] - middle - 0.03f));
        break;
    }
    case DYE_CLOUDS: {
        float p[3] = {place[0] / scale, place[1] / scale, place[2] / scale};
        float n = value_noise(r->key, p);
        for (int k = 0; k < 3; k++) p[k] = 2.1f * p[k] + 7;
        n = 0.65f * n + 0.35f * value_noise(r->key + 1, p);
        a = smooth(0.42f, 0.5f, n);
        b = smooth(0.6f, 0.66f, n);
        break;
    }
    case DYE_SPECKS: {
        float n = lattice(r->key, (int)floorf(across), (int)floorf(up), 0);
        a = n < r->ratio ? 1 : 0;
        b = n < 0.4f * r->ratio ? 1 : 0;
        break;
    }
    default:
        break;
    }
    *third = clamp(b, 0, 1);
    *second = clamp(a, 0, 1) * (1 - *third);
}

/* Rotates the hue about the grey axis (1, 1, 1). */
static void turn_hue(float rgb[3], float turn) {
    float c = cosf(turn * 2 * (float)M_PI), s = sinf(turn * 2 * (float)M_PI) * 0.57735027f,
          mean = (rgb[0] + rgb[1] + rgb[2]) / 3 * (1 - c), in[3] = {rgb[0], rgb[1], rgb[2]};
    for (int k = 0; k < 3; k++) rgb[k] = c * in[k] + mean + s * (in[(k + 2) % 3] - in[(k + 1) % 3]);
}

/* The texel's brightness relative to the part's, as a factor. Texels of another hue (prints) count as the
 * part's brightness, so nothing printed is left. */
static float fold(const dye_part *part, const float rgb[3], float detail) {
    float luminance = 0.299f * rgb[0] + 0.587f * rgb[1] + 0.114f * rgb[2];
    float sum = rgb[0] + rgb[1] + rgb[2] + 0.15f,
          middle = part->color[0] + part->color[1] + part->color[2] + 0.15f, other = 0;
    for (int k = 0; k < 3; k++) other += fabsf(rgb[k] / sum - part->color[k] / middle);
    luminance += (part->luminance - luminance) * smooth(0.08f, 0.2f, other);
    float relative = (luminance - part->luminance) / fmaxf(part->luminance, 0.3f);
    return clamp(1 + detail * relative, 0.35f, 1.7f);
}

static void dye_texel(const dye_recipe *r, const dye_part *part, const float place[3], const uint8_t *in,
                      uint8_t *out) {
    float rgb[3] = {in[0] / 255.0f, in[1] / 255.0f, in[2] / 255.0f}, to[3];
    if (r->pattern == DYE_KEEP) {
        memcpy(to, rgb, sizeof to);
        if (r->hue_turn != 0) turn_hue(to, r->hue_turn);
        for (int k = 0; k < 3; k++) to[k] *= r->value;
    } else {
        float second, third, factor = fold(part, rgb, r->detail);
        dye_shares(r, part, place, &second, &third);
        for (int k = 0; k < 3; k++)
            to[k] = factor * ((1 - second - third) * r->color[0][k] + second * r->color[1][k] +
                              third * r->color[2][k]);
    }
    for (int k = 0; k < 3; k++) out[k] = float_to_u8(to[k]);
}

sherf_status dye_apply(context *c, const dye_map *map, const image_u8 *texture, const dye_recipe *recipe,
                       const dye_cut *cut, image_u8 *out) {
    *out = (image_u8){0};
    if (texture->channels != 4 || texture->width != map->width || texture->height != map->height)
        return failure(c, SHERF_BAD_ARGUMENT, "the texture is not the map's");
    size_t texels = (size_t)map->width * (size_t)map->height;
    uint8_t *rgba = mem_alloc(c, texels, 4);
    if (!rgba) return SHERF_NO_MEMORY;
    for (size_t at = 0; at < texels; at++) {
        memcpy(rgba + 4 * at, texture->data + 4 * at, 4);
        if (map->part[at] == DYE_NONE) continue;
        const float *place = map->place + 3 * at;
        dye_texel(&recipe[map->part[at]], &map->of[map->part[at]], place, texture->data + 4 * at,
                  rgba + 4 * at);
        if (cut && (place[1] < cut->legs_m || fabsf(place[0]) > cut->arms_m)) rgba[4 * at + 3] = 0;
    }
    *out = (image_u8){map->width, map->height, 4, rgba};
    return SHERF_OK;
}
