/* The mask on a grid round the person: distances outside it, and points on its edge. */
#include <math.h>
#include <string.h>

#include "estimate/fit_inside.h"

static double clamp(double x, double low, double high) {
    return x < low ? low : x > high ? high : x;
}

/* ---- the grid ---- */

/* Covers the network's region and all landmarks, clipped to the photo. */
static bool place_grid(const body_fit_input *in, fit_mask *mask) {
    const photo_region *r = &in->person->region;
    double low[2] = {1e30, 1e30}, high[2] = {-1e30, -1e30};
    const double c = cos((double)r->angle_rad), s = sin((double)r->angle_rad);
    for (int i = 0; i < 4; i++) {
        double u = (i & 1) - 0.5, v = (i >> 1) - 0.5;
        const double at[2] = {(double)r->centre_px[0] + (double)r->side_px * (c * u - s * v),
                              (double)r->centre_px[1] + (double)r->side_px * (s * u + c * v)};
        for (int k = 0; k < 2; k++) low[k] = fmin(low[k], at[k]), high[k] = fmax(high[k], at[k]);
    }
    for (int l = 0; l < LANDMARKS; l++)
        for (int k = 0; k < 2; k++) {
            double at = (double)in->person->landmark[l].place_px[k];
            low[k] = fmin(low[k], at - 0.05 * (double)r->side_px);
            high[k] = fmax(high[k], at + 0.05 * (double)r->side_px);
        }
    const double size[2] = {in->width_px, in->height_px};
    for (int k = 0; k < 2; k++)
        low[k] = clamp(low[k], 0, size[k] - 1), high[k] = clamp(high[k], 0, size[k] - 1);
    double longer = fmax(high[0] - low[0], high[1] - low[1]);
    if (!(longer >= 8)) return false;
    mask->cell_px = fmax(longer / (FIT_MASK_SIDE - 1), 0.5);
    mask->left = low[0];
    mask->top = low[1];
    mask->width = 1 + (int)((high[0] - low[0]) / mask->cell_px);
    mask->height = 1 + (int)((high[1] - low[1]) / mask->cell_px);
    return mask->width >= 4 && mask->height >= 4;
}

/* The mean of a picture of one channel over a square. */
static float mean_of(const sherf_image *image, double x, double y, double side) {
    int n = (int)clamp(ceil(side), 1, 8);
    double sum = 0;
    for (int j = 0; j < n; j++)
        for (int i = 0; i < n; i++) {
            int px = (int)clamp(floor(x + side * ((i + 0.5) / n - 0.5) + 0.5), 0, image->width - 1);
            int py = (int)clamp(floor(y + side * ((j + 0.5) / n - 0.5) + 0.5), 0, image->height - 1);
            sum += (double)image->data[(size_t)py * (size_t)image->width + (size_t)px];
        }
    return (float)(sum / (n * n));
}

/* The network's own mask, bilinear; 0 outside its region. */
static float inside_of(const photo_person *p, double x, double y) {
    const photo_region *r = &p->region;
    double c = cos((double)r->angle_rad), s = sin((double)r->angle_rad);
    double dx = (x - (double)r->centre_px[0]) / (double)r->side_px,
           dy = (y - (double)r->centre_px[1]) / (double)r->side_px;
    double u = (c * dx + s * dy + 0.5) * PERSON_MASK_SIDE - 0.5,
           v = (-s * dx + c * dy + 0.5) * PERSON_MASK_SIDE - 0.5;
    if (!(u > -1 && v > -1 && u < PERSON_MASK_SIDE && v < PERSON_MASK_SIDE)) return 0;
    int u0 = (int)floor(u), v0 = (int)floor(v);
    double sum = 0;
    for (int j = 0; j < 2; j++)
        for (int i = 0; i < 2; i++) {
            int a = (int)clamp(u0 + i, 0, PERSON_MASK_SIDE - 1),
                b = (int)clamp(v0 + j, 0, PERSON_MASK_SIDE - 1);
            sum += (i ? u - u0 : 1 - u + u0) * (j ? v - v0 : 1 - v + v0) *
                   (double)p->inside[b * PERSON_MASK_SIDE + a];
        }
    return (float)sum;
}

static void fill_grid(const body_fit_input *in, fit_mask *mask) {
    for (int y = 0; y < mask->height; y++)
        for (int x = 0; x < mask->width; x++) {
            double px = mask->left + mask->cell_px * x, py = mask->top + mask->cell_px * y;
            float v = in->mask ? mean_of(in->mask, px, py, mask->cell_px) : inside_of(in->person, px, py);
            mask->inside[(size_t)y * (size_t)mask->width + (size_t)x] = isfinite(v) ? v : 0;
        }
}

/* ---- distances: the lower envelope of parabolas, along columns and then along rows ---- */

/* out[i] = min over k of (i - k)^2 + in[k]; where and from: n and n + 1 places of scratch. */
static void envelope(int n, const double *in, double *out, int *where, double *from) {
    int count = 0;
    where[0] = 0;
    from[0] = -1e30;
    from[1] = 1e30;
    for (int k = 1; k < n; k++) {
        double at;
        for (;;) {
            int w = where[count];
            at = ((in[k] + (double)k * k) - (in[w] + (double)w * w)) / (2. * (k - w));
            if (at > from[count]) break;
            count--;
        }
        where[++count] = k;
        from[count] = at;
        from[count + 1] = 1e30;
    }
    count = 0;
    for (int i = 0; i < n; i++) {
        while (from[count + 1] < i) count++;
        out[i] = (double)(i - where[count]) * (i - where[count]) + in[where[count]];
    }
}

static sherf_status measure(context *c, fit_mask *mask) {
    enum { FAR = 1 << 20 };
    size_t w = (size_t)mask->width, h = (size_t)mask->height, longer = w > h ? w : h;
    double *squared = mem_alloc(c, w * h, sizeof *squared),
           *line = mem_alloc(c, 3 * longer + 1, sizeof *line);
    int *where = mem_alloc(c, longer, sizeof *where);
    sherf_status status = SHERF_NO_MEMORY;
    if (!squared || !line || !where) goto done;
    for (size_t x = 0; x < w; x++) {
        for (size_t y = 0; y < h; y++) line[y] = mask->inside[y * w + x] >= 0.5f ? 0 : FAR;
        envelope((int)h, line, line + longer, where, line + 2 * longer);
        for (size_t y = 0; y < h; y++) squared[y * w + x] = line[longer + y];
    }
    for (size_t y = 0; y < h; y++) {
        envelope((int)w, squared + y * w, line, where, line + 2 * longer);
        for (size_t x = 0; x < w; x++)
            mask->outside_px[y * w + x] = (float)(mask->cell_px * fmax(0, sqrt(line[x]) - 0.5));
    }
    status = SHERF_OK;
done:
    mem_free(squared);
    mem_free(line);
    mem_free(where);
    return status;
}

double fit_mask_outside(const fit_mask *mask, const double place_px[2], double slope[2]) {
    double x = (place_px[0] - mask->left) / mask->cell_px, y = (place_px[1] - mask->top) / mask->cell_px;
    double gx = clamp(x, 0, mask->width - 1.001), gy = clamp(y, 0, mask->height - 1.001);
    size_t x0 = (size_t)gx, y0 = (size_t)gy, w = (size_t)mask->width;
    double fx = gx - (double)x0, fy = gy - (double)y0;
    const float *d = mask->outside_px + y0 * w + x0;
    double top = (1 - fx) * (double)d[0] + fx * (double)d[1],
           bottom = (1 - fx) * (double)d[w] + fx * (double)d[w + 1];
    double beyond[2] = {x - gx, y - gy}, far = hypot(beyond[0], beyond[1]);
    slope[0] = ((1 - fy) * (double)(d[1] - d[0]) + fy * (double)(d[w + 1] - d[w])) / mask->cell_px;
    slope[1] = (bottom - top) / mask->cell_px;
    if (far > 0.01)
        for (int k = 0; k < 2; k++) slope[k] = beyond[k] / far;
    return (1 - fy) * top + fy * bottom + mask->cell_px * (far > 0.01 ? far : 0);
}

/* ---- the edge ---- */

/* The downhill direction of the mask's probabilities at a cell, by least squares over 5 x 5. */
static bool downhill(const fit_mask *mask, int x, int y, double n[2]) {
    n[0] = n[1] = 0;
    for (int j = -2; j <= 2; j++)
        for (int i = -2; i <= 2; i++) {
            int px = (int)clamp(x + i, 0, mask->width - 1), py = (int)clamp(y + j, 0, mask->height - 1);
            double v = (double)mask->inside[(size_t)py * (size_t)mask->width + (size_t)px];
            n[0] -= i * v;
            n[1] -= j * v;
        }
    double length = hypot(n[0], n[1]);
    if (!(length > 1)) return false;
    n[0] /= length, n[1] /= length;
    return true;
}

/* Points between neighbouring cells of which one is in the mask; takes one of `every` crossings. */
static int crossings(const body_fit_input *in, fit_mask *mask, int every) {
    int seen = 0;
    mask->outline = 0;
    for (int y = 0; y + 1 < mask->height; y++)
        for (int x = 0; x + 1 < mask->width; x++)
            for (int across = 0; across < 2; across++) {
                const float *a = mask->inside + (size_t)y * (size_t)mask->width + (size_t)x;
                double v = (double)a[0], u = (double)a[across ? 1 : mask->width], n[2];
                if ((v >= 0.5) == (u >= 0.5)) continue;
                double t = (v - 0.5) / (v - u);
                const double at[2] = {mask->left + mask->cell_px * (x + (across ? t : 0)),
                                      mask->top + mask->cell_px * (y + (across ? 0 : t))};
                double margin = 1 + mask->cell_px;
                if (at[0] < margin || at[1] < margin || at[0] > in->width_px - 1 - margin ||
                    at[1] > in->height_px - 1 - margin)
                    continue;
                if (!downhill(mask, x, y, n)) continue;
                if (every && seen % every == 0 && mask->outline < FIT_OUTLINE_MAX) {
                    memcpy(mask->point_px[mask->outline], at, sizeof at);
                    memcpy(mask->normal[mask->outline++], n, sizeof n);
                }
                seen++;
            }
    return seen;
}

sherf_status fit_mask_create(context *c, const body_fit_input *in, fit_mask **out) {
    *out = NULL;
    fit_mask *mask = mem_zero(c, 1, sizeof *mask);
    if (!mask) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_NO_MEMORY;
    if (!place_grid(in, mask)) {
        status = failure(c, SHERF_MISMATCH, "fit: the person lies outside the picture");
        goto fail;
    }
    size_t cells = (size_t)mask->width * (size_t)mask->height;
    mask->inside = mem_alloc(c, cells, sizeof *mask->inside);
    mask->outside_px = mem_alloc(c, cells, sizeof *mask->outside_px);
    if (!mask->inside || !mask->outside_px) goto fail;
    fill_grid(in, mask);
    if ((status = measure(c, mask))) goto fail;
    int all = crossings(in, mask, 0);
    if (all) crossings(in, mask, 1 + (all - 1) / FIT_OUTLINE_MAX);
    *out = mask;
    return SHERF_OK;
fail:
    fit_mask_free(mask);
    return status;
}

void fit_mask_free(fit_mask *mask) {
    if (!mask) return;
    mem_free(mask->inside);
    mem_free(mask->outside_px);
    mem_free(mask);
}
