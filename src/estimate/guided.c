/* guided: sums over windows slide down and along in bands of rows. Each band starts afresh, so a row's result
 * does not depend on how rows are shared among threads. */
#include "estimate/guided.h"

#include <string.h>

enum { BAND_ROWS = 64, MOMENTS = 14, PLANE = 4 };

/* Writes one pixel's summands to out[MOMENTS] or out[PLANE]. */
typedef struct {
    const sherf_image *guide;
    const float *value, *weight; /* of the moments */
    const float *planes;         /* of the planes' means */
    float *out;
    double *columns; /* sums of each column, a row of them a band */
    int radius;
    float epsilon;
} fitting;

/* w, w I, w I I', w p, w p I */
static void moments_add(const fitting *f, int y, double sign, double *columns) {
    const int width = f->guide->width;
    for (int x = 0; x < width; x++, columns += MOMENTS) {
        size_t at = (size_t)y * width + x;
        const float *I = f->guide->data + at * 3;
        const double w = sign * f->weight[at], p = w * f->value[at];
        const double r = w * I[0], g = w * I[1], b = w * I[2];
        columns[0] += w;
        columns[1] += r, columns[2] += g, columns[3] += b;
        columns[4] += r * I[0], columns[5] += r * I[1], columns[6] += r * I[2];
        columns[7] += g * I[1], columns[8] += g * I[2], columns[9] += b * I[2];
        columns[10] += p;
        columns[11] += p * I[0], columns[12] += p * I[1], columns[13] += p * I[2];
    }
}

static void planes_add(const fitting *f, int y, double sign, double *columns) {
    const size_t n = (size_t)f->guide->width * PLANE;
    const float *row = f->planes + (size_t)y * n;
    for (size_t i = 0; i < n; i++) columns[i] += sign * row[i];
}

/* The plane that fits best: (Sigma + epsilon I) a = covariance of colour and value. */
static void plane_solve(const double sum[MOMENTS], double epsilon, float out[PLANE]) {
    const double scale = 1 / sum[0];
    double m[MOMENTS];
    for (int i = 0; i < MOMENTS; i++) m[i] = sum[i] * scale;
    const double rr = m[4] - m[1] * m[1] + epsilon, rg = m[5] - m[1] * m[2], rb = m[6] - m[1] * m[3];
    const double gg = m[7] - m[2] * m[2] + epsilon, gb = m[8] - m[2] * m[3];
    const double bb = m[9] - m[3] * m[3] + epsilon;
    const double r = m[11] - m[1] * m[10], g = m[12] - m[2] * m[10], b = m[13] - m[3] * m[10];
    const double i_rr = gg * bb - gb * gb, i_rg = gb * rb - rg * bb, i_rb = rg * gb - gg * rb;
    const double i_gg = rr * bb - rb * rb, i_gb = rb * rg - rr * gb, i_bb = rr * gg - rg * rg;
    const double over = 1 / (rr * i_rr + rg * i_rg + rb * i_rb);
    const double a[3] = {(i_rr * r + i_rg * g + i_rb * b) * over, (i_rg * r + i_gg * g + i_gb * b) * over,
                         (i_rb * r + i_gb * g + i_bb * b) * over};
    for (int k = 0; k < 3; k++) out[k] = (float)a[k];
    out[3] = (float)(m[10] - a[0] * m[1] - a[1] * m[2] - a[2] * m[3]);
}

/* Makes one row from the sums of its columns. n: sums per column. rows: the number of rows they hold. */
static void row_finish(const fitting *f, int y, int rows, int n, const double *columns) {
    const int width = f->guide->width, radius = f->radius;
    double sum[MOMENTS] = {0};
    float *out = f->out + (size_t)y * width * PLANE;
    for (int x = 0; x < radius && x < width; x++)
        for (int i = 0; i < n; i++) sum[i] += columns[x * n + i];
    for (int x = 0; x < width; x++, out += PLANE) {
        const int last = x + radius, gone = x - radius - 1;
        if (last < width)
            for (int i = 0; i < n; i++) sum[i] += columns[last * n + i];
        if (gone >= 0)
            for (int i = 0; i < n; i++) sum[i] -= columns[gone * n + i];
        if (n == MOMENTS) {
            plane_solve(sum, f->epsilon, out);
            continue;
        }
        const double count =
            (double)rows * ((last < width ? last : width - 1) - (gone >= 0 ? gone + 1 : 0) + 1);
        for (int i = 0; i < PLANE; i++) out[i] = (float)(sum[i] / count);
    }
}

static void bands(const fitting *f, int64_t begin, int64_t end, int n,
                  void add(const fitting *f, int y, double sign, double *columns)) {
    const int height = f->guide->height;
    const size_t sums = (size_t)f->guide->width * n;
    for (int64_t band = begin; band < end; band++) {
        double *columns = f->columns + (size_t)band * f->guide->width * MOMENTS;
        const int from = (int)band * BAND_ROWS, to = from + BAND_ROWS < height ? from + BAND_ROWS : height;
        int first = from - f->radius > 0 ? from - f->radius : 0, past = first; /* rows in the sums */
        memset(columns, 0, sums * sizeof *columns);
        for (int y = from; y < to; y++) {
            while (past <= y + f->radius && past < height) add(f, past++, 1, columns);
            while (first < y - f->radius) add(f, first++, -1, columns);
            row_finish(f, y, past - first, n, columns);
        }
    }
}

static void fit_bands(void *arg, int64_t begin, int64_t end, int thread) {
    bands(arg, begin, end, MOMENTS, moments_add);
}
static void mean_bands(void *arg, int64_t begin, int64_t end, int thread) {
    bands(arg, begin, end, PLANE, planes_add);
}

sherf_status guided_fit(context *c, const sherf_image *guide, const float *value, const float *weight,
                        int radius, float epsilon, float *planes) {
    sherf_status status = SHERF_NO_MEMORY;
    const size_t n = (size_t)guide->width * guide->height;
    const int64_t count = (guide->height + BAND_ROWS - 1) / BAND_ROWS;
    float *each = mem_alloc(c, n, PLANE * sizeof *each);
    double *columns = mem_alloc(c, (size_t)count * guide->width, MOMENTS * sizeof *columns);
    if (!each || !columns) goto done;
    fitting f = {guide, value, weight, each, each, columns, radius, epsilon};
    parallel_for(c, count, 1, fit_bands, &f);
    f.out = planes;
    parallel_for(c, count, 1, mean_bands, &f);
    status = SHERF_OK;
done:
    mem_free(each);
    mem_free(columns);
    return status;
}
