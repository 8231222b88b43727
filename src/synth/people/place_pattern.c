/* Procedural patterns: every texel follows from its place and the key. */
#include "synth/people/place_pattern.h"

#include <math.h>
#include <string.h>

/* ---- noise ---- */

static float cell(uint64_t key, int x, int y) {
    return (float)(splitmix64(key ^ splitmix64((uint64_t)(uint32_t)x << 32 | (uint32_t)y)) >> 40) * 0x1p-24f;
}

static float between(uint64_t key, int x, int y, float low, float high) {
    return low + (high - low) * cell(key, x, y);
}

static float mix(float a, float b, float t) {
    return a + (b - a) * t;
}

static float smooth_step(float low, float high, float x) {
    float t = (x - low) / (high - low);
    t = t > 0 ? t < 1 ? t : 1 : 0;
    return t * t * (3 - 2 * t);
}

float place_noise(uint64_t key, int cells, float u, float v) {
    u = (u - floorf(u)) * (float)cells, v = (v - floorf(v)) * (float)cells;
    int x = (int)u, y = (int)v;
    float s = smooth_step(0, 1, u - (float)x), t = smooth_step(0, 1, v - (float)y);
    x %= cells, y %= cells;
    int x1 = (x + 1) % cells, y1 = (y + 1) % cells;
    return mix(mix(cell(key, x, y), cell(key, x1, y), s), mix(cell(key, x, y1), cell(key, x1, y1), s), t);
}

float place_clouds(uint64_t key, int cells, int octaves, float u, float v) {
    float sum = 0, all = 0, strength = 1;
    for (int i = 0; i < octaves; i++, cells *= 2, strength /= 2) {
        sum += strength * place_noise(key + (uint64_t)i, cells, u, v);
        all += strength;
    }
    return sum / all;
}

/* ---- patterns ---- */

typedef struct {
    const float (*color)[3];
    uint64_t key;
} recipe;

static void blend(const float a[3], const float b[3], float t, float rgb[3]) {
    for (int k = 0; k < 3; k++) rgb[k] = mix(a[k], b[k], t);
}

static void scale(float rgb[3], float by) {
    for (int k = 0; k < 3; k++) rgb[k] *= by;
}

/* Number n's own colour, mixed from all of the recipe's. */
static void own_color(const recipe *r, int n, float rgb[3]) {
    int which = (int)(3 * cell(r->key + 7, n, 1));
    blend(r->color[which % 3], r->color[(which + 1) % 3], 0.6f * cell(r->key + 7, n, 2), rgb);
    scale(rgb, between(r->key + 7, n, 3, 0.6f, 1.15f));
}

static void plaster(const recipe *r, float u, float v, float rgb[3]) {
    float stain = place_clouds(r->key, 3, 4, u, v), fine = place_noise(r->key + 9, 128, u, v);
    memcpy(rgb, r->color[0], 3 * sizeof *rgb);
    scale(rgb, 1 + 0.14f * (stain - 0.5f) + 0.05f * (fine - 0.5f));
}

static void planks(const recipe *r, float u, float v, float rgb[3]) {
    const int across = 8;
    int column = (int)(u * (float)across) % across;
    float x = u * (float)across - (float)column, along = v + cell(r->key, column, 0);
    along -= floorf(along);
    int board = along < between(r->key, column, 1, 0.35f, 0.65f);
    float grain =
        place_clouds(r->key + 20 + (uint64_t)(2 * column + board), 2, 4, 3 * x + 0.1f * along, along);
    float fine = place_noise(r->key + 3, 96, u, 0.06f * v + 0.5f);
    blend(r->color[0], r->color[1], 0.75f * cell(r->key, 2 * column + board, 2), rgb);
    scale(rgb, 0.82f + 0.25f * grain + 0.12f * fine);
    float edge = fminf(fminf(x, 1 - x), 6 * fabsf(along - between(r->key, column, 1, 0.35f, 0.65f)));
    blend(r->color[2], rgb, smooth_step(0, 0.05f, edge), rgb);
}

/* Rectangles in rows, every second row moved by `shift`. */
static void courses(const recipe *r, int across, int rows, float shift, float joint, float u, float v,
                    float rgb[3]) {
    int row = (int)(v * (float)rows) % rows;
    float y = v * (float)rows - (float)row, x = u * (float)across + (row % 2 ? shift : 0);
    int column = (int)x % across;
    x -= floorf(x);
    float aspect = (float)rows / (float)across;
    float edge = fminf(fminf(x, 1 - x) * aspect, fminf(y, 1 - y));
    float rough = place_clouds(r->key + 5, 16, 3, u, v);
    blend(r->color[0], r->color[1], cell(r->key, column, row), rgb);
    scale(rgb, 0.85f + 0.3f * rough);
    float filler[3];
    memcpy(filler, r->color[2], sizeof filler);
    scale(filler, 0.8f + 0.4f * rough);
    blend(filler, rgb, smooth_step(0.5f * joint, joint, edge), rgb);
}

static void specks(const recipe *r, float u, float v, float rgb[3]) {
    float broad = place_clouds(r->key, 4, 3, u, v), fine = place_noise(r->key + 9, 200, u, v);
    float middle = place_noise(r->key + 8, 60, u, v);
    blend(r->color[0], r->color[1], smooth_step(0.55f, 0.9f, 0.6f * fine + 0.4f * middle), rgb);
    scale(rgb, 0.75f + 0.3f * broad + 0.2f * fine);
}

static void grass(const recipe *r, float u, float v, float rgb[3]) {
    float broad = place_clouds(r->key, 3, 4, u, v);
    float blades = place_noise(r->key + 4, 150, u, 0.35f * v) * place_noise(r->key + 5, 90, u + 0.3f * v, v);
    blend(r->color[0], r->color[1], smooth_step(0.35f, 0.75f, broad), rgb);
    scale(rgb, 0.55f + 1.1f * blades + 0.2f * broad);
    blend(rgb, r->color[2], smooth_step(0.66f, 0.8f, place_clouds(r->key + 6, 5, 3, u, v)), rgb);
}

static void stripes(const recipe *r, float u, float v, float rgb[3]) {
    int count = 4 + (int)(12 * cell(r->key, 1, 1));
    float x = u * (float)count;
    int n = (int)x % count;
    x -= floorf(x);
    float wide = between(r->key, 2, 2, 0.3f, 0.7f);
    blend(r->color[0], r->color[n % 3 == 2 ? 2 : 1], x < wide ? 0 : 1, rgb);
    scale(rgb, 0.94f + 0.12f * place_noise(r->key + 3, 100, u, v));
}

static void checks(const recipe *r, float u, float v, float rgb[3]) {
    int count = 4 + (int)(8 * cell(r->key, 1, 1));
    float x = u * (float)count, y = v * (float)count, wide = between(r->key, 2, 2, 0.3f, 0.6f);
    x -= floorf(x), y -= floorf(y);
    blend(r->color[0], r->color[1], 0.5f * ((x < wide) + (y < wide)), rgb);
    if (fabsf(x - 0.8f) < 0.04f || fabsf(y - 0.8f) < 0.04f) memcpy(rgb, r->color[2], 3 * sizeof *rgb);
    scale(rgb, 0.94f + 0.12f * place_noise(r->key + 3, 100, u, v));
}

static void waves(const recipe *r, float u, float v, float rgb[3]) {
    float du = place_clouds(r->key, 4, 4, u, v) - 0.5f, dv = place_clouds(r->key + 50, 4, 4, u, v) - 0.5f;
    float at = place_clouds(r->key + 90, 3, 4, u + 0.5f * du, v + 0.5f * dv);
    blend(r->color[0], r->color[1], smooth_step(0.42f, 0.5f, at), rgb);
    blend(rgb, r->color[2], smooth_step(0.58f, 0.62f, at), rgb);
    scale(rgb, 0.85f + 0.3f * place_noise(r->key + 91, 64, u, v));
}

static void blocks(const recipe *r, float u, float v, float rgb[3]) {
    float low_u = 0, high_u = 1, low_v = 0, high_v = 1;
    int n = 1;
    for (int depth = 0; depth < 6; depth++) { /* a random tree of cuts */
        bool tall = high_v - low_v > high_u - low_u;
        float t = between(r->key, n, 5, 0.25f, 0.75f);
        if (depth > 2 && cell(r->key, n, 6) < 0.3f) break;
        float cut = tall ? mix(low_v, high_v, t) : mix(low_u, high_u, t);
        bool above = (tall ? v : u) >= cut;
        *(tall ? above ? &low_v : &high_v : above ? &low_u : &high_u) = cut;
        n = 2 * n + above;
    }
    own_color(r, n, rgb);
    float edge = fminf(fminf(u - low_u, high_u - u), fminf(v - low_v, high_v - v));
    scale(rgb, (edge < 0.006f ? 0.4f : 0.9f) + 0.2f * place_clouds(r->key + 8, 8, 3, u, v));
}

static void books(const recipe *r, float u, float v, float rgb[3]) {
    enum { ROWS = 4, SPINES = 26 };
    int row = (int)(v * ROWS) % ROWS;
    float y = v * ROWS - (float)row, x = u * SPINES + 0.35f * sinf(40 * u + (float)row);
    int n = row * 64 + (int)floorf(x);
    x -= floorf(x);
    own_color(r, n, rgb);
    scale(rgb, 0.55f + 0.6f * (1 - 4 * (x - 0.5f) * (x - 0.5f)));
    float top = between(r->key, n, 4, 0.6f, 0.9f);
    if (fabsf(y - 0.7f * top) < 0.025f) scale(rgb, 1.5f);
    if (y > top || cell(r->key, n, 8) < 0.06f) {
        memcpy(rgb, r->color[2], 3 * sizeof *rgb);
        scale(rgb, 0.25f);
    }
    if (y < 0.06f || y > 0.97f) memcpy(rgb, r->color[2], 3 * sizeof *rgb); /* the board */
}

static void view(const recipe *r, float u, float v, float rgb[3]) {
    float line = 0.35f + 0.25f * place_clouds(r->key, 4, 3, u, 0.5f);
    float leaf = place_clouds(r->key + 4, 8, 3, u, v), sky[3] = {0.8f, 0.88f, 0.98f};
    blend(r->color[0], r->color[1], leaf, rgb);
    scale(rgb, 0.5f + 0.8f * leaf);
    blend(rgb, sky, smooth_step(-0.03f, 0.03f, v - line), rgb);
}

static void shade(place_pattern pattern, const recipe *r, float u, float v, float rgb[3]) {
    int tiles = 2 + (int)(5 * cell(r->key, 3, 3));
    switch (pattern) {
    case PATTERN_PLANKS:
        planks(r, u, v, rgb);
        break;
    case PATTERN_TILES:
        courses(r, tiles, tiles, 0, 0.05f, u, v, rgb);
        break;
    case PATTERN_BRICKS:
        courses(r, 4, 12, 0.5f, 0.16f, u, v, rgb);
        break;
    case PATTERN_SPECKS:
        specks(r, u, v, rgb);
        break;
    case PATTERN_GRASS:
        grass(r, u, v, rgb);
        break;
    case PATTERN_STRIPES:
        stripes(r, u, v, rgb);
        break;
    case PATTERN_CHECKS:
        checks(r, u, v, rgb);
        break;
    case PATTERN_WAVES:
        waves(r, u, v, rgb);
        break;
    case PATTERN_BLOCKS:
        blocks(r, u, v, rgb);
        break;
    case PATTERN_BOOKS:
        books(r, u, v, rgb);
        break;
    case PATTERN_VIEW:
        view(r, u, v, rgb);
        break;
    default:
        plaster(r, u, v, rgb);
    }
}

static uint8_t to_byte(float x) {
    return (uint8_t)(x > 0 ? x < 1 ? 255 * x + 0.5f : 255 : 0);
}

/* Overlapping leaves, later ones lighter: ellipses with a rib. */
static void draw_leaves(const recipe *r, int side, uint8_t *texel) {
    enum { LEAVES = 90 };
    for (int n = 0; n < LEAVES; n++) {
        float turn = between(r->key, n, 0, 0, 2 * (float)M_PI), long_ = between(r->key, n, 1, 0.05f, 0.11f);
        float broad = long_ * between(r->key, n, 2, 0.25f, 0.5f), light = 0.55f + 0.6f * (float)n / LEAVES;
        float x0 = between(r->key, n, 3, 0.12f, 0.88f), y0 = between(r->key, n, 4, 0.12f, 0.88f), rgb[3];
        blend(r->color[0], r->color[1], cell(r->key, n, 5), rgb);
        if (cell(r->key, n, 6) < 0.04f) memcpy(rgb, r->color[2], sizeof rgb);
        int reach = (int)(long_ * (float)side) + 1, cx = (int)(x0 * (float)side),
            cy = (int)(y0 * (float)side);
        for (int y = cy - reach; y <= cy + reach; y++)
            for (int x = cx - reach; x <= cx + reach; x++) {
                if (x < 0 || y < 0 || x >= side || y >= side) continue;
                float dx = (float)x / (float)side - x0, dy = (float)y / (float)side - y0;
                float a = (dx * cosf(turn) + dy * sinf(turn)) / long_;
                float b = (dy * cosf(turn) - dx * sinf(turn)) / broad;
                if (a * a + b * b > 1) continue;
                uint8_t *to = texel + 4 * ((size_t)y * (size_t)side + (size_t)x);
                float own = light * (0.85f + 0.25f * b) * (fabsf(b) < 0.08f ? 1.15f : 1);
                for (int k = 0; k < 3; k++) to[k] = to_byte(own * rgb[k]);
                to[3] = 255;
            }
    }
}

sherf_status place_pattern_create(context *c, place_pattern pattern, const float color[PATTERN_COLORS][3],
                                  uint64_t key, int side, trace_texture **out) {
    const recipe r = {color, key};
    const bool holes = pattern == PATTERN_LEAVES;
    const size_t channels = holes ? 4 : 3;
    *out = NULL;
    uint8_t *texel = mem_zero(c, (size_t)side * (size_t)side, channels);
    if (!texel) return SHERF_NO_MEMORY;
    if (holes) {
        for (size_t i = 0; i < (size_t)side * (size_t)side; i++) /* shown where a texel is half a hole */
            for (int k = 0; k < 3; k++) texel[4 * i + (size_t)k] = to_byte(0.7f * color[0][k]);
        draw_leaves(&r, side, texel);
    }
    for (int y = 0; y < side && !holes; y++)
        for (int x = 0; x < side; x++) {
            float rgb[3];
            /* row 0 is the top, where v is 1 */
            shade(pattern, &r, ((float)x + 0.5f) / (float)side, 1 - ((float)y + 0.5f) / (float)side, rgb);
            for (int k = 0; k < 3; k++)
                texel[3 * ((size_t)y * (size_t)side + (size_t)x) + (size_t)k] = to_byte(rgb[k]);
        }
    sherf_status status = trace_texture_create(c, side, side, (int)channels, texel, out);
    mem_free(texel);
    return status;
}
