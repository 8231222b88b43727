/* The loss as a picture, drawn pixel by pixel. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/canvas.h"
#include "train/history.h"

enum { WIDTH = 960, HEIGHT = 600, LEFT = 92, RIGHT = 24, TOP = 44, BOTTOM = 60 };

typedef struct {
    canvas canvas;
    double x_max;        /* steps 1 .. x_max */
    double y_min, y_max; /* log10 of the loss */
} chart;

static const color ink = 0x202020, grid_color = 0xE2E2E2, pale = 0xB9C6DC;

static void segment(chart *p, double x0, double y0, double x1, double y1, int thick, color v) {
    canvas_segment(&p->canvas, x0, y0, x1, y1, thick, v);
}

static void write_text(chart *p, int x, int y, const char *text, color v) {
    canvas_text(&p->canvas, x, y, text, v);
}

static double x_of(const chart *p, double step) {
    return LEFT + (WIDTH - LEFT - RIGHT) * (p->x_max > 1 ? (step - 1) / (p->x_max - 1) : 0.5);
}

static double y_of(const chart *p, double v) {
    double t = (log10(fmax(v, 1e-12)) - p->y_min) / (p->y_max - p->y_min);
    return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * fmin(fmax(t, 0), 1);
}

/* ---- curves: the loss and its parts as they are weighted in it (resnet50 before its weight) ---- */
enum { CURVES = 6 };
static const struct {
    const char *name;
    color color;
} curves[CURVES] = {{"loss", 0x1F3F7F},   {"color", 0xC04030}, {"mask", 0x2F8F4F},
                    {"1-ssim", 0xC08A1E}, {"lpips", 0x7A4FA0}, {"resnet50", 0x3A8A9A}};

static double curve_value(const loss_values *v, int curve) {
    const double values[CURVES] = {v->total,    100 * v->color, 10 * v->mask,
                                   1 - v->ssim, v->lpips,       v->resnet50};
    return values[curve];
}

/* Mean over the last `window` finite values; NaN before the first. Called for every point in order. */
typedef struct {
    double sum;
    int64_t n;
} running;

static double running_mean(running *r, const history *h, int curve, int64_t i, int64_t window) {
    double in = curve_value(&h->point[i].loss, curve);
    if (isfinite(in)) r->sum += in, r->n++;
    if (i >= window) {
        double out = curve_value(&h->point[i - window].loss, curve);
        if (isfinite(out)) r->sum -= out, r->n--;
    }
    return r->n ? r->sum / (double)r->n : NAN;
}

static int64_t window_of(const history *h) {
    return h->count / 40 + 1;
}

static void range_of(chart *p, const history *h) {
    double low = INFINITY, high = 0;
    for (int curve = 0; curve < CURVES; curve++) {
        running r = {0};
        for (int64_t i = 0; i < h->count; i++) {
            double v = running_mean(&r, h, curve, i, window_of(h));
            if (!isfinite(v) || v <= 0) continue;
            low = fmin(low, v);
            high = fmax(high, curve ? v : fmax(v, curve_value(&h->point[i].loss, 0)));
        }
    }
    if (!(high > 0) || !isfinite(high)) low = 0.1, high = 10;
    low = fmax(low, high * 1e-6);
    p->y_min = log10(low) - 0.05;
    p->y_max = log10(high) + 0.05;
    if (p->y_max - p->y_min < 0.3) p->y_min -= 0.15, p->y_max += 0.15;
    p->x_max = h->count ? (double)h->point[h->count - 1].step : 1;
}

static void draw_curve(chart *p, const history *h, int curve, bool smooth) {
    running r = {0};
    double x0 = NAN, y0 = NAN;
    bool any = false;
    for (int64_t i = 0; i < h->count; i++) {
        double v =
            smooth ? running_mean(&r, h, curve, i, window_of(h)) : curve_value(&h->point[i].loss, curve);
        if (!isfinite(v)) continue;
        double x = x_of(p, (double)h->point[i].step), y = y_of(p, v);
        if (!any) x0 = x, y0 = y;
        segment(p, x0, y0, x, y, smooth ? 2 : 1, smooth ? curves[curve].color : pale);
        any = true, x0 = x, y0 = y;
    }
}

/* ---- axes ---- */
static void draw_y_axis(chart *p) {
    char text[32];
    bool sparse = p->y_max - p->y_min > 2.2;
    for (int e = (int)floor(p->y_min); e <= (int)ceil(p->y_max); e++)
        for (int k = 1; k < 10; k++) {
            double v = k * pow(10, e), at = log10(v);
            if (at < p->y_min || at > p->y_max) continue;
            double y = y_of(p, v);
            segment(p, LEFT, y, WIDTH - RIGHT, y, 1, grid_color);
            if (k != 1 && (sparse || (k != 2 && k != 5))) continue;
            snprintf(text, sizeof text, "%.3g", v);
            write_text(p, LEFT - 10 - canvas_text_width(text), (int)y - 7, text, ink);
        }
}

static void draw_x_axis(chart *p) {
    char text[32];
    double step = pow(10, floor(log10(fmax(p->x_max, 2) / 2)));
    while (p->x_max / step > 8) step *= p->x_max / step > 16 ? 5 : 2;
    if (step < 1) step = 1;
    for (double x = step; x <= p->x_max; x += step) {
        double at = x_of(p, x);
        segment(p, at, TOP, at, HEIGHT - BOTTOM, 1, grid_color);
        snprintf(text, sizeof text, "%.0f", x);
        if (x >= 10000) snprintf(text, sizeof text, "%.5gk", x / 1000);
        write_text(p, (int)at - canvas_text_width(text) / 2, HEIGHT - BOTTOM + 8, text, ink);
    }
}

static void draw_frame(chart *p) {
    segment(p, LEFT, TOP, LEFT, HEIGHT - BOTTOM, 1, ink);
    segment(p, LEFT, HEIGHT - BOTTOM, WIDTH - RIGHT, HEIGHT - BOTTOM, 1, ink);
    write_text(p, (WIDTH - canvas_text_width("step")) / 2, HEIGHT - 24, "step", ink);
}

static void draw_legend(chart *p, const history *h) {
    int x = LEFT;
    for (int curve = 0; curve < CURVES; curve++) {
        bool any = false;
        for (int64_t i = 0; i < h->count && !any; i++) any = isfinite(curve_value(&h->point[i].loss, curve));
        if (!any) continue;
        segment(p, x, 20, x + 24, 20, 3, curves[curve].color);
        write_text(p, x + 34, 14, curves[curve].name, ink);
        x += 64 + canvas_text_width(curves[curve].name);
    }
}

sherf_status history_plot(context *c, const history *h, const char *path) {
    chart p = {0};
    sherf_status status = canvas_create(c, WIDTH, HEIGHT, &p.canvas);
    if (status != SHERF_OK) return status;
    range_of(&p, h);
    draw_y_axis(&p);
    draw_x_axis(&p);
    draw_curve(&p, h, 0, false);
    for (int curve = CURVES - 1; curve >= 0; curve--) draw_curve(&p, h, curve, true);
    draw_frame(&p);
    draw_legend(&p, h);
    status = canvas_write(c, &p.canvas, path);
    canvas_free(&p.canvas);
    return status;
}
