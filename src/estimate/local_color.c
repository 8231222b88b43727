/* local_color: histograms over (row, column, red, green, blue) in one grid of coarse cells, person and
 * background side by side, blurred along all five axes and read between the cells: a bilateral grid. */
#include "estimate/local_color.h"

#include <string.h>

enum { BINS = 12, COLORS = BINS * BINS * BINS, SPLAT_PIXELS = 300000 };
/* Added to a colour's share as noise, so that colours seen nowhere say nothing. */
static const float rare = 1e-3f;

typedef struct {
    const sherf_image *picture;
    float *value;
    int rows, columns, cell;
    float *grid, *blurred; /* [rows, columns, BINS, BINS, BINS, 2]: person, background */
    float *total;          /* [rows, columns, 2]: over the colours */
    int axis;
} histograms;

static int bin_of(float v) {
    int i = (int)(v * BINS);
    return i < 0 ? 0 : i >= BINS ? BINS - 1 : i;
}

static void splat(const histograms *h) {
    const int width = h->picture->width, height = h->picture->height;
    int step = 1;
    while ((double)width * height / ((double)step * step) > SPLAT_PIXELS) step++;
    for (int y = step / 2; y < height; y += step)
        for (int x = step / 2; x < width; x += step) {
            size_t at = (size_t)y * width + x;
            const float *I = h->picture->data + at * 3, p = h->value[at];
            float weight = (2 * p - 1) * (2 * p - 1);
            weight *= weight;
            float *g = h->grid + (((size_t)(y / h->cell) * h->columns + x / h->cell) * COLORS +
                                  (bin_of(I[0]) * BINS + bin_of(I[1])) * BINS + bin_of(I[2])) *
                                     2;
            g[p < 0.5f] += weight;
        }
}

/* Blurs with 1 2 1 along one axis; the ends count twice. */
static void blur_cells(void *arg, int64_t begin, int64_t end, int thread) {
    const histograms *h = arg;
    const int count[5] = {h->rows, h->columns, BINS, BINS, BINS};
    size_t stride = 2;
    for (int a = 4; a > h->axis; a--) stride *= (size_t)count[a];
    const size_t line = stride * (size_t)count[h->axis];
    /* begin and end: outer positions of the lines */
    for (int64_t o = begin; o < end; o++)
        for (int i = 0; i < count[h->axis]; i++) {
            const float *in = h->grid + (size_t)o * line + (size_t)i * stride;
            const float *before = i ? in - stride : in, *after = i + 1 < count[h->axis] ? in + stride : in;
            float *out = h->blurred + (size_t)o * line + (size_t)i * stride;
            for (size_t k = 0; k < stride; k++) out[k] = 0.25f * (before[k] + after[k]) + 0.5f * in[k];
        }
}

static void blur(context *c, histograms *h) {
    const int count[5] = {h->rows, h->columns, BINS, BINS, BINS};
    int64_t outer = 1;
    for (h->axis = 0; h->axis < 5; h->axis++) {
        if (h->axis == 0)
            blur_cells(h, 0, 1, 0);
        else
            parallel_for(c, outer, 1, blur_cells, h);
        float *swap = h->grid;
        h->grid = h->blurred;
        h->blurred = swap;
        outer *= count[h->axis];
    }
    for (int i = 0; i < h->rows * h->columns; i++) {
        const float *g = h->grid + (size_t)i * COLORS * 2;
        float sum[2] = {0};
        for (int k = 0; k < COLORS; k++) sum[0] += g[2 * k], sum[1] += g[2 * k + 1];
        h->total[2 * i] = sum[0], h->total[2 * i + 1] = sum[1];
    }
}

/* The two cells between which v lies (in cells, their centres at whole numbers + 1/2). */
static float between(float v, int n, int *a, int *b) {
    v -= 0.5f;
    if (v < 0) v = 0;
    if (v > n - 1) v = n - 1;
    *a = (int)v;
    *b = *a + 1 < n ? *a + 1 : *a;
    return v - *a;
}

/* The person's and the background's local share of this colour, and the sums they are shares of. */
static void look_up(const histograms *h, int x, int y, const float I[3], float found[2], float total[2]) {
    int at[5][2];
    float f[5];
    f[0] = between((y + 0.5f) / h->cell, h->rows, &at[0][0], &at[0][1]);
    f[1] = between((x + 0.5f) / h->cell, h->columns, &at[1][0], &at[1][1]);
    for (int k = 0; k < 3; k++) f[2 + k] = between(I[k] * BINS, BINS, &at[2 + k][0], &at[2 + k][1]);
    found[0] = found[1] = total[0] = total[1] = 0;
    for (int s = 0; s < 4; s++) {
        const int cell = at[0][s & 1] * h->columns + at[1][s >> 1];
        const float weight = (s & 1 ? f[0] : 1 - f[0]) * (s >> 1 ? f[1] : 1 - f[1]);
        const float *g = h->grid + (size_t)cell * COLORS * 2;
        for (int k = 0; k < 2; k++) total[k] += weight * h->total[2 * cell + k];
        for (int b = 0; b < 8; b++) {
            const float w =
                weight * (b & 1 ? f[2] : 1 - f[2]) * (b & 2 ? f[3] : 1 - f[3]) * (b & 4 ? f[4] : 1 - f[4]);
            const float *v = g + 2 * ((at[2][b & 1] * BINS + at[3][b >> 1 & 1]) * BINS + at[4][b >> 2]);
            found[0] += w * v[0], found[1] += w * v[1];
        }
    }
}

static void sharpen_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const histograms *h = arg;
    const int width = h->picture->width;
    for (int y = (int)begin; y < end; y++)
        for (int x = 0; x < width; x++) {
            float *p = &h->value[(size_t)y * width + x], found[2], total[2];
            if (*p < 0.01f || *p > 0.995f) continue;
            look_up(h, x, y, h->picture->data + ((size_t)y * width + x) * 3, found, total);
            if (!(total[0] > 1 && total[1] > 1)) continue;
            const float likely = (found[0] / total[0] + rare) / (found[1] / total[1] + rare);
            const float odds = *p / (1 - *p) * likely;
            *p = odds / (1 + odds);
        }
}

sherf_status local_color_sharpen(context *c, const sherf_image *picture, int cell, float *value) {
    sherf_status status = SHERF_NO_MEMORY;
    histograms h = {picture, value, (picture->height + cell - 1) / cell, (picture->width + cell - 1) / cell,
                    cell};
    const size_t cells = (size_t)h.rows * h.columns;
    float *a = h.grid = mem_zero(c, cells * COLORS, 2 * sizeof *a);
    float *b = h.blurred = mem_alloc(c, cells * COLORS, 2 * sizeof *b);
    h.total = mem_alloc(c, cells, 2 * sizeof *h.total);
    if (a && b && h.total) {
        splat(&h);
        blur(c, &h);
        parallel_for(c, picture->height, 8, sharpen_rows, &h);
        status = SHERF_OK;
    }
    mem_free(a);
    mem_free(b);
    mem_free(h.total);
    return status;
}
