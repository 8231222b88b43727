/* palette: median cut over a histogram of 5 bits per channel, and ordered dithering. */
#include <stdlib.h>
#include <string.h>

#include "io/palette.h"

enum { BINS = 1 << 15, UNKNOWN = 256 };

typedef struct {
    uint16_t bin; /* r << 10 | g << 5 | b */
    uint32_t count;
} entry;

/* Entries first to end - 1 of the list. */
typedef struct {
    int first, end, axis, width; /* the longest side and its length */
    uint64_t count;
} box;

struct palette {
    uint32_t histogram[BINS], sum[BINS][3]; /* pixels, and of their values */
    uint16_t nearest[BINS];                 /* index of the nearest colour; UNKNOWN: not computed yet */
    entry list[BINS];
    box boxes[256];
    uint8_t rgb[256][3];
    int colors;
};

sherf_status palette_create(context *c, palette **out) {
    *out = mem_zero(c, 1, sizeof **out);
    return *out ? SHERF_OK : SHERF_NO_MEMORY;
}

void palette_free(palette *p) {
    mem_free(p);
}

static int channel(uint16_t bin, int axis) {
    return bin >> (10 - 5 * axis) & 31;
}

static int bin_of(const int rgb[3]) {
    return (rgb[0] >> 3) << 10 | (rgb[1] >> 3) << 5 | rgb[2] >> 3;
}

static void measure(const palette *p, box *b) {
    int low[3] = {31, 31, 31}, high[3] = {0, 0, 0};
    b->count = 0;
    for (int i = b->first; i < b->end; i++) {
        for (int a = 0; a < 3; a++) {
            int v = channel(p->list[i].bin, a);
            if (v < low[a]) low[a] = v;
            if (v > high[a]) high[a] = v;
        }
        b->count += p->list[i].count;
    }
    b->axis = 0;
    for (int a = 1; a < 3; a++)
        if (high[a] - low[a] > high[b->axis] - low[b->axis]) b->axis = a;
    b->width = b->first < b->end ? high[b->axis] - low[b->axis] : 0;
}

#define BY_CHANNEL(name, axis)                                                                               \
    static int name(const void *a, const void *b) {                                                          \
        int x = channel(((const entry *)a)->bin, axis), y = channel(((const entry *)b)->bin, axis);          \
        return x != y ? x - y : ((const entry *)a)->bin - ((const entry *)b)->bin;                           \
    }
BY_CHANNEL(by_red, 0)
BY_CHANNEL(by_green, 1)
BY_CHANNEL(by_blue, 2)

/* Cuts the box at the median of its pixels; the second half becomes `other`. */
static void cut(palette *p, box *b, box *other) {
    static int (*const order[3])(const void *, const void *) = {by_red, by_green, by_blue};
    qsort(p->list + b->first, (size_t)(b->end - b->first), sizeof *p->list, order[b->axis]);
    uint64_t half = 0;
    int at = b->first;
    while (at < b->end - 1 && (half += p->list[at].count) * 2 < b->count) at++;
    if (at == b->first) at++;
    *other = (box){.first = at, .end = b->end};
    b->end = at;
    measure(p, b);
    measure(p, other);
}

static void mean_color(const palette *p, const box *b, uint8_t rgb[3]) {
    for (int a = 0; a < 3; a++) {
        uint64_t sum = 0;
        for (int i = b->first; i < b->end; i++) sum += p->sum[p->list[i].bin][a];
        rgb[a] = (uint8_t)(b->count ? (sum + b->count / 2) / b->count : 0);
    }
}

static void choose(palette *p, int max) {
    int entries = 0;
    for (int i = 0; i < BINS; i++)
        if (p->histogram[i]) p->list[entries++] = (entry){(uint16_t)i, p->histogram[i]};
    p->boxes[0] = (box){.end = entries};
    measure(p, &p->boxes[0]);
    for (p->colors = 1; p->colors < max; p->colors++) {
        int best = -1;
        for (int i = 0; i < p->colors; i++) /* many pixels over a long range */
            if (p->boxes[i].width && (best < 0 || p->boxes[i].count * (uint64_t)p->boxes[i].width >
                                                      p->boxes[best].count * (uint64_t)p->boxes[best].width))
                best = i;
        if (best < 0) break;
        cut(p, &p->boxes[best], &p->boxes[p->colors]);
    }
    for (int i = 0; i < p->colors; i++) mean_color(p, &p->boxes[i], p->rgb[i]);
    for (int i = 0; i < BINS; i++) p->nearest[i] = UNKNOWN;
}

static int nearest(palette *p, const int rgb[3]) {
    uint16_t *known = &p->nearest[bin_of(rgb)];
    if (*known != UNKNOWN) return *known;
    int best = 0, min = INT32_MAX;
    for (int i = 0; i < p->colors; i++) {
        int d = 0;
        for (int a = 0; a < 3; a++) {
            int middle = (rgb[a] & ~7) + 4 - p->rgb[i][a];
            d += middle * middle * (a == 1 ? 2 : 1); /* the eye sees green best */
        }
        if (d < min) min = d, best = i;
    }
    *known = (uint16_t)best;
    return best;
}

void palette_apply(palette *p, const uint8_t *rgba, int width, int height, bool alpha, uint32_t color[256],
                   uint8_t *index, int stride) {
    /* Bayer's matrix of 4 x 4, centred, spread over one step of 5 bits. */
    static const int8_t bayer[4][4] = {{-8, 0, -6, 2}, {4, -4, 6, -2}, {-5, 3, -7, 1}, {7, -1, 5, -3}};
    memset(p->histogram, 0, sizeof p->histogram);
    memset(p->sum, 0, sizeof p->sum);
    for (size_t i = 0; i < (size_t)width * (size_t)height; i++) {
        const uint8_t *from = rgba + 4 * i;
        if (alpha && from[3] < 128) continue;
        int bin = bin_of((const int[3]){from[0], from[1], from[2]});
        p->histogram[bin]++;
        for (int a = 0; a < 3; a++) p->sum[bin][a] += from[a];
    }
    choose(p, alpha ? 255 : 256);
    memset(color, 0, 256 * sizeof *color);
    for (int i = 0; i < p->colors; i++)
        color[i] = 0xff000000u | (uint32_t)p->rgb[i][0] << 16 | (uint32_t)p->rgb[i][1] << 8 | p->rgb[i][2];
    for (int i = p->colors; i < 256; i++) color[i] = 0xff000000u;
    if (alpha) color[PALETTE_CLEAR] = 0;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const uint8_t *from = rgba + 4 * ((size_t)y * (size_t)width + (size_t)x);
            int rgb[3];
            for (int a = 0; a < 3; a++) {
                int v = from[a] + bayer[y & 3][x & 3] / 2;
                rgb[a] = v < 0 ? 0 : v > 255 ? 255 : v;
            }
            index[(size_t)y * (size_t)stride + (size_t)x] =
                alpha && from[3] < 128 ? PALETTE_CLEAR : (uint8_t)nearest(p, rgb);
        }
}
