/* The projected box as a mask, pixel for pixel as OpenCV 4.6 fills the six faces one by one: a polygon is its
 * border, drawn as 8-connected lines that are first clipped to the picture in whole pixels, and the spans
 * between its unclipped edges, whose columns are followed in 16.16 fixed point from row to row. */
#include <math.h>
#include <string.h>

#include "scene/scene.h"

typedef struct {
    int64_t x, y;
} pixel;
typedef struct {
    int width, height;
    uint8_t *mask;
} canvas;

/* Where a point lies beyond the picture: 1 left, 2 right, 4 above, 8 below. */
static int outside_x(const canvas *m, pixel p) {
    return p.x < 0 ? 1 : p.x >= m->width ? 2 : 0;
}
static int outside(const canvas *m, pixel p) {
    return outside_x(m, p) | (p.y < 0 ? 4 : p.y >= m->height ? 8 : 0);
}

/* Moves an end onto row or column `to`, in doubles cut to whole pixels. */
static void cut_row(pixel *end, pixel a, pixel b, int64_t to) {
    end->x += (int64_t)((double)(to - end->y) * (double)(b.x - a.x) / (double)(b.y - a.y));
    end->y = to;
}
static void cut_column(pixel *end, pixel a, pixel b, int64_t to) {
    end->y += (int64_t)((double)(to - end->x) * (double)(b.y - a.y) / (double)(b.x - a.x));
    end->x = to;
}

/* Cohen-Sutherland, rows first; false where nothing is left (the ends may have moved all the same). */
static bool clip(const canvas *m, pixel *a, pixel *b) {
    int at_a = outside(m, *a), at_b = outside(m, *b);
    if (at_a & at_b) return false;
    if (at_a & 12) {
        cut_row(a, *a, *b, at_a & 8 ? m->height - 1 : 0);
        at_a = outside_x(m, *a);
    }
    if (at_b & 12) {
        cut_row(b, *a, *b, at_b & 8 ? m->height - 1 : 0);
        at_b = outside_x(m, *b);
    }
    if (at_a & at_b) return false;
    if (at_a) cut_column(a, *a, *b, at_a == 1 ? 0 : m->width - 1);
    if (at_b) cut_column(b, *a, *b, at_b == 1 ? 0 : m->width - 1);
    return true;
}

/* Bresenham's line from left to right. */
static void draw_line(const canvas *m, pixel a, pixel b) {
    if (b.x < a.x) {
        pixel swap = a;
        a = b, b = swap;
    }
    int64_t dx = b.x - a.x, dy = b.y - a.y, down = dy < 0 ? -1 : 1;
    dy *= down;
    int64_t major = dx > dy ? dx : dy, minor = dx > dy ? dy : dx, error = major - 2 * minor;
    for (int64_t i = 0; i <= major; i++) {
        m->mask[a.y * m->width + a.x] = 1;
        bool aside = error < 0;
        error += (aside ? 2 * major : 0) - 2 * minor;
        if (dy > dx || aside) a.y += down;
        if (dy <= dx || aside) a.x++;
    }
}

typedef struct {
    int64_t y0, y1, x, dx; /* rows [y0, y1); column at y0 and its change a row, 16.16 */
} edge;

static void fill_spans(const canvas *m, const edge *edges, int count) {
    for (int64_t y = 0; y < m->height; y++) {
        int64_t x[4];
        int n = 0;
        for (int i = 0; i < count; i++) {
            if (y < edges[i].y0 || y >= edges[i].y1) continue;
            int64_t at = edges[i].x + (y - edges[i].y0) * edges[i].dx;
            int k = n++;
            for (; k > 0 && x[k - 1] > at; k--) x[k] = x[k - 1];
            x[k] = at;
        }
        for (int k = 0; k + 1 < n; k += 2) {
            int64_t first = (x[k] + 65535) >> 16, last = x[k + 1] >> 16;
            if (first < 0) first = 0;
            if (last >= m->width) last = m->width - 1;
            if (first <= last) memset(m->mask + y * m->width + first, 1, (size_t)(last - first + 1));
        }
    }
}

static void fill_face(const canvas *m, const pixel corner[4]) {
    edge edges[4];
    int count = 0;
    for (int i = 0; i < 4; i++) {
        pixel a = corner[(i + 3) % 4], b = corner[i], clipped_a = a, clipped_b = b;
        if (clip(m, &clipped_a, &clipped_b)) draw_line(m, clipped_a, clipped_b);
        if (a.y == b.y) continue;
        if (a.y > b.y) {
            pixel swap = a;
            a = b, b = swap;
        }
        edges[count++] = (edge){a.y, b.y, a.x * 65536, (b.x - a.x) * 65536 / (b.y - a.y)};
    }
    fill_spans(m, edges, count);
}

void box_mask(const sherf_camera *camera, const float min_world[3], const float max_world[3], uint8_t *mask) {
    /* corner k: bit 0 is x, bit 1 y, bit 2 z */
    static const int faces[6][4] = {{0, 2, 3, 1}, {4, 6, 7, 5}, {0, 4, 5, 1},
                                    {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 5, 7, 3}};
    const float *K = camera->K, *R = camera->R, *T = camera->T_m;
    canvas m = {camera->width_px, camera->height_px, mask};
    pixel corner[8];
    memset(mask, 0, (size_t)m.width * (size_t)m.height);
    for (int i = 0; i < 8; i++) {
        double p[3], x[3], q[3];
        for (int k = 0; k < 3; k++) p[k] = i >> k & 1 ? max_world[k] : min_world[k];
        for (int k = 0; k < 3; k++) x[k] = R[3 * k] * p[0] + R[3 * k + 1] * p[1] + R[3 * k + 2] * p[2] + T[k];
        for (int k = 0; k < 3; k++) q[k] = K[3 * k] * x[0] + K[3 * k + 1] * x[1] + K[3 * k + 2] * x[2];
        /* what is farther than a million pixels away (a corner in the camera's plane) is as good as there */
        double u = fmin(fmax(rint(q[0] / q[2]), -1e6), 1e6), v = fmin(fmax(rint(q[1] / q[2]), -1e6), 1e6);
        corner[i] = (pixel){(int64_t)u, (int64_t)v};
    }
    for (int f = 0; f < 6; f++) {
        pixel face[4];
        for (int k = 0; k < 4; k++) face[k] = corner[faces[f][k]];
        fill_face(&m, face);
    }
}
