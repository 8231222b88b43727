/* Lines with error bars, as SVG and as PNG: each stroke goes to both files. */
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "data/text.h"
#include "experiment/page.h"
#include "io/canvas.h"

enum { WIDTH = 960, HEIGHT = 560, LEFT = 92, RIGHT = 24, TOP = 84, BOTTOM = 64, CAP = 5, MARK = 3 };
static const color ink = 0x202020, grid_color = 0xE2E2E2;
static const color line_colors[PAGE_SERIES] = {0x1F3F7F, 0xC04030, 0x2F8F4F, 0xC08A1E,
                                               0x7A4FA0, 0x3A8A9A, 0x8A5A3A, 0x606060};

typedef struct {
    text_builder svg;
    canvas png;
    double x_min, x_max, y_min, y_max;
} pen;

static void stroke(pen *p, double x0, double y0, double x1, double y1, int thick, color v) {
    const double half = (thick - 1) / 2.0; /* the canvas draws lines right of and below their points */
    canvas_segment(&p->png, x0 - half, y0 - half, x1 - half, y1 - half, thick, v);
    text_add(&p->svg, "<path d=\"M%.1f %.1fL%.1f %.1f\" stroke=\"#%06x\" stroke-width=\"%d\"/>\n", x0, y0, x1,
             y1, (unsigned)v, thick);
}

/* x is the text's left end (anchor 0), centre (1) or right end (2); y is the letters' top. */
static void words(pen *p, double x, double y, int anchor, const char *text) {
    static const char *const anchors[] = {"start", "middle", "end"};
    canvas_text(&p->png, (int)x - anchor * canvas_text_width(text) / 2, (int)y, text, ink);
    text_add(&p->svg, "<text x=\"%.1f\" y=\"%.1f\" text-anchor=\"%s\">", x, y + CANVAS_LETTER_HEIGHT,
             anchors[anchor]);
    for (const char *t = text; *t; t++) text_add(&p->svg, strchr("<>&\"", *t) ? "&#%d;" : "%c", *t);
    text_add(&p->svg, "</text>\n");
}

static double x_of(const pen *p, double x) {
    return LEFT + (WIDTH - LEFT - RIGHT) * (x - p->x_min) / (p->x_max - p->x_min);
}

static double y_of(const pen *p, double y) {
    return HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (y - p->y_min) / (p->y_max - p->y_min);
}

/* ---- ranges ---- */
static void take_in(pen *p, const page_point *at) {
    const double v[3] = {at->y.mean, at->y.low, at->y.high};
    p->x_min = fmin(p->x_min, at->x);
    p->x_max = fmax(p->x_max, at->x);
    for (int i = 0; i < 3; i++)
        if (!isnan(v[i])) p->y_min = fmin(p->y_min, v[i]), p->y_max = fmax(p->y_max, v[i]);
}

static void widen(double *low, double *high, double margin_min) {
    const double margin = fmax((*high - *low) * 0.06, margin_min);
    *low -= margin;
    *high += margin;
}

static void range(pen *p, const page_plot *q) {
    p->x_min = p->y_min = INFINITY;
    p->x_max = p->y_max = -INFINITY;
    for (int i = 0; i < q->series; i++)
        for (int k = 0; k < q->line[i].points; k++) take_in(p, &q->line[i].point[k]);
    if (!(p->x_max >= p->x_min)) p->x_min = 0, p->x_max = 1;
    if (!(p->y_max >= p->y_min)) p->y_min = 0, p->y_max = 1;
    widen(&p->x_min, &p->x_max, 1e-3);
    widen(&p->y_min, &p->y_max, 1e-3);
}

/* ---- axes ---- */
static double round_step(double range) {
    double step = pow(10, floor(log10(range / 4)));
    while (range / step > 8) step *= range / step > 16 ? 5 : 2;
    return step;
}

static void y_axis(pen *p) {
    const double step = round_step(p->y_max - p->y_min);
    const int decimals = step < 1 ? (int)ceil(-log10(step) - 1e-9) : 0;
    char text[32];
    for (double i = ceil(p->y_min / step); i * step <= p->y_max; i++) {
        const double y = y_of(p, i * step);
        snprintf(text, sizeof text, "%.*f", decimals, i * step);
        stroke(p, LEFT, y, WIDTH - RIGHT, y, 1, grid_color);
        words(p, LEFT - 10, y - CANVAS_LETTER_HEIGHT / 2, 2, text);
    }
}

static void x_axis(pen *p, double given) {
    const double step = given > 0 ? given : round_step(p->x_max - p->x_min);
    char text[32];
    for (double i = ceil(p->x_min / step); i * step <= p->x_max; i++) {
        const double x = x_of(p, i * step);
        snprintf(text, sizeof text, "%.5g", i * step + 0.0);
        stroke(p, x, TOP, x, HEIGHT - BOTTOM, 1, grid_color);
        words(p, x, HEIGHT - BOTTOM + 8, 1, text);
    }
}

static void frame(pen *p, const page_plot *q) {
    stroke(p, LEFT, TOP, LEFT, HEIGHT - BOTTOM, 1, ink);
    stroke(p, LEFT, HEIGHT - BOTTOM, WIDTH - RIGHT, HEIGHT - BOTTOM, 1, ink);
    words(p, WIDTH / 2.0, HEIGHT - 26, 1, q->x);
    words(p, LEFT, TOP - 24, 0, q->y);
    words(p, WIDTH / 2.0, 10, 1, q->title);
}

static void legend(pen *p, const page_plot *q) {
    double x = LEFT;
    for (int i = 0; i < q->series; i++) {
        stroke(p, x, 42, x + 24, 42, 3, line_colors[i]);
        words(p, x + 34, 36, 0, q->line[i].label);
        x += 64 + canvas_text_width(q->line[i].label);
    }
}

/* ---- lines ---- */
static void error_bar(pen *p, const page_point *at, color v) {
    const double x = x_of(p, at->x), low = y_of(p, at->y.low), high = y_of(p, at->y.high);
    if (isnan(at->y.low)) return;
    stroke(p, x, low, x, high, 1, v);
    stroke(p, x - CAP, low, x + CAP, low, 1, v);
    stroke(p, x - CAP, high, x + CAP, high, 1, v);
}

static void line(pen *p, const page_series *s, color v) {
    const page_point *before = NULL;
    for (int i = 0; i < s->points; i++) {
        const page_point *at = &s->point[i];
        if (isnan(at->y.mean)) continue;
        const double x = x_of(p, at->x), y = y_of(p, at->y.mean);
        if (before) stroke(p, x_of(p, before->x), y_of(p, before->y.mean), x, y, 2, v);
        stroke(p, x - MARK, y, x + MARK, y, 2 * MARK, v);
        error_bar(p, at, v);
        before = at;
    }
}

static void draw(pen *p, const page_plot *q) {
    range(p, q);
    text_add(&p->svg,
             "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" font-family=\"sans-serif\" "
             "font-size=\"16\">\n<rect width=\"%d\" height=\"%d\" fill=\"#fff\"/>\n",
             WIDTH, HEIGHT, WIDTH, HEIGHT);
    y_axis(p);
    x_axis(p, q->step);
    frame(p, q);
    legend(p, q);
    for (int i = 0; i < q->series; i++) line(p, &q->line[i], line_colors[i]);
    text_add(&p->svg, "</svg>\n");
}

sherf_status page_plot_write(context *c, const page_plot *q, const char *folder) {
    pen p = {.svg = {.c = c}};
    char name[40], path[PATH_LENGTH];
    sherf_status status = canvas_create(c, WIDTH, HEIGHT, &p.png);
    if (status != SHERF_OK) return status;
    draw(&p, q);
    char *svg = text_take(&p.svg);
    snprintf(name, sizeof name, "%s.svg", q->name);
    status = page_file_write(c, folder, name, svg);
    if (status == SHERF_OK && snprintf(path, sizeof path, "%s/%s.png", folder, q->name) >= (int)sizeof path)
        status = failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", folder);
    if (status == SHERF_OK) status = canvas_write(c, &p.png, path);
    mem_free(svg);
    canvas_free(&p.png);
    return status;
}
