/* Edges of baked frames. The opacity of a surface, the share of samples that hit it, rises over one pixel.
 * Where pixels are small, a tent filter makes it rise over some millimetres; where a pixel is wider than
 * that, it rises faster instead. The line of half opacity stays where it was, and so do the colours inside.
 * Pixels that become visible outside take the colours of the surface beside them. */
#include "baked/form.h"

#include <math.h>
#include <string.h>

enum { REACH_MAX = 32, LOOK = 4 };
static const float faint = 0.01f;    /* opacities below this are not drawn */
static const float slope_max = 1.5f; /* the maximum factor by which it rises faster than over a pixel */

typedef struct {
    const baked_soft *s;
    sherf_frame *frame;
    int reach, width, height; /* in pixels: of the tent; of the rectangle */
    float tent[2 * REACH_MAX + 1];
    float *across, *soft; /* of the rectangle: blurred along rows; along both */
} soften_job;

static void tent_make(soften_job *j) {
    float sum = 0;
    j->reach = (int)ceilf(j->s->radius_px) - 1;
    if (j->reach > REACH_MAX) j->reach = REACH_MAX;
    for (int i = -j->reach; i <= j->reach; i++)
        sum += j->tent[i + j->reach] = fmaxf(0, 1 - fabsf((float)i) / j->s->radius_px);
    for (int i = 0; i <= 2 * j->reach; i++) j->tent[i] /= sum;
}

static const float *opacity_row(const soften_job *j, int row) {
    const sherf_image *o = &j->frame->opacity;
    return o->data + (size_t)(j->s->top + row) * (size_t)o->width + (size_t)j->s->left;
}

/* Outside the rectangle the picture continues like its edge, which is empty or cut off. */
static int clamped(int i, int count) {
    return i < 0 ? 0 : i < count ? i : count - 1;
}

static void along_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const soften_job *j = arg;
    for (int64_t y = begin; y < end; y++) {
        const float *from = opacity_row(j, (int)y);
        float *to = j->across + (size_t)y * (size_t)j->width;
        memset(to, 0, (size_t)j->width * sizeof *to);
        for (int i = -j->reach; i <= j->reach; i++) {
            const float share = j->tent[i + j->reach];
            const int x0 = clamped(-i, j->width + 1), x1 = clamped(j->width - i, j->width + 1);
            for (int x = 0; x < x0; x++) to[x] += share * from[0];
            for (int x = x0; x < x1; x++) to[x] += share * from[x + i];
            for (int x = x1; x < j->width; x++) to[x] += share * from[j->width - 1];
        }
    }
}

static void along_columns(void *arg, int64_t begin, int64_t end, int thread) {
    const soften_job *j = arg;
    for (int64_t y = begin; y < end; y++) {
        float *to = j->soft + (size_t)y * (size_t)j->width;
        memset(to, 0, (size_t)j->width * sizeof *to);
        for (int i = -j->reach; i <= j->reach; i++) {
            const size_t row = (size_t)clamped((int)y + i, j->height);
            const float share = j->tent[i + j->reach], *from = j->across + row * (size_t)j->width;
            for (int x = 0; x < j->width; x++) to[x] += share * from[x];
        }
    }
}

/* Colour, not multiplied by opacity, and depth of the surface beside a pixel that hits nothing; false: there
 * is none. */
static bool beside(const soften_job *j, int x, int y, float rgb[3], float *depth) {
    const int step = 1 + (j->reach - 1) / LOOK;
    const float *bg = j->s->background;
    float sum = 0, out[4] = {0, 0, 0, 0};
    for (int v = y - j->reach; v <= y + j->reach; v += step) {
        if (v < 0 || v >= j->height) continue;
        const float *row = opacity_row(j, v);
        for (int u = x - j->reach; u <= x + j->reach; u += step) {
            if (u < 0 || u >= j->width || !(row[u] > 0)) continue;
            const float share = j->tent[u - x + j->reach] * j->tent[v - y + j->reach];
            const size_t at = (size_t)(row + u - j->frame->opacity.data);
            const float *color = j->frame->color.data + 3 * at;
            for (int k = 0; k < 3; k++) out[k] += share * (color[k] - (1 - row[u]) * bg[k]);
            out[3] += share * row[u] * j->frame->depth.data[at];
            sum += share * row[u];
        }
    }
    if (!(sum > 1e-6f)) return false;
    for (int k = 0; k < 3; k++) rgb[k] = out[k] / sum;
    *depth = out[3] / sum;
    return true;
}

/* Pixels that hit nothing come first: they read the others as they were drawn. */
static void outside(void *arg, int64_t begin, int64_t end, int thread) {
    const soften_job *j = arg;
    for (int64_t y = begin; y < end; y++) {
        const float *opacity = opacity_row(j, (int)y);
        float *soft = j->soft + (size_t)y * (size_t)j->width;
        for (int x = 0; x < j->width; x++) {
            const size_t at = (size_t)(opacity + x - j->frame->opacity.data);
            float rgb[3], depth;
            if (opacity[x] > 0 || !(soft[x] > faint)) continue;
            if (!beside(j, x, (int)y, rgb, &depth)) continue;
            for (int k = 0; k < 3; k++)
                j->frame->color.data[3 * at + (size_t)k] =
                    soft[x] * rgb[k] + (1 - soft[x]) * j->s->background[k];
            j->frame->depth.data[at] = depth;
        }
    }
}

static void inside(void *arg, int64_t begin, int64_t end, int thread) {
    const soften_job *j = arg;
    for (int64_t y = begin; y < end; y++) {
        float *opacity = j->frame->opacity.data + (opacity_row(j, (int)y) - j->frame->opacity.data);
        const float *soft = j->soft + (size_t)y * (size_t)j->width;
        for (int x = 0; x < j->width; x++) {
            const size_t at = (size_t)(opacity + x - j->frame->opacity.data);
            const float o = opacity[x], s = soft[x] < 0.999f ? soft[x] : 1;
            float *color = j->frame->color.data + 3 * at;
            for (int k = 0; k < 3 && o > 0 && s < 1; k++) {
                const float bg = j->s->background[k];
                color[k] = s * (color[k] - (1 - o) * bg) / o + (1 - s) * bg;
            }
            if (o > 0 || j->frame->depth.data[at] > 0) opacity[x] = s;
        }
    }
}

/* Opacity rises this many times as fast, about a half. */
static void sharpen(void *arg, int64_t begin, int64_t end, int thread) {
    const soften_job *j = arg;
    const float slope = fminf(2 - j->s->radius_px, slope_max);
    for (int64_t y = begin; y < end; y++) {
        float *opacity = j->frame->opacity.data + (opacity_row(j, (int)y) - j->frame->opacity.data);
        for (int x = 0; x < j->width; x++) {
            const float o = opacity[x], s = fminf(fmaxf(slope * (o - 0.5f) + 0.5f, 0), 1);
            float *color = j->frame->color.data + 3 * (size_t)(opacity + x - j->frame->opacity.data);
            if (!(o > 0 && o < 1)) continue;
            for (int k = 0; k < 3; k++) {
                const float bg = j->s->background[k];
                color[k] = s * (color[k] - (1 - o) * bg) / o + (1 - s) * bg;
            }
            opacity[x] = s;
        }
    }
}

sherf_status baked_soften(context *c, const baked_soft *s, sherf_frame *frame) {
    soften_job j = {.s = s, .frame = frame, .width = s->right - s->left, .height = s->bottom - s->top};
    if (!(s->radius_px > 1)) {
        parallel_for(c, j.height, 16, sharpen, &j);
        return SHERF_OK;
    }
    tent_make(&j);
    const size_t n = (size_t)j.width * (size_t)j.height;
    j.across = mem_alloc(c, n, sizeof *j.across);
    j.soft = mem_alloc(c, n, sizeof *j.soft);
    sherf_status status = j.across && j.soft ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        parallel_for(c, j.height, 16, along_rows, &j);
        parallel_for(c, j.height, 16, along_columns, &j);
        parallel_for(c, j.height, 16, outside, &j);
        parallel_for(c, j.height, 16, inside, &j);
    }
    mem_free(j.across);
    mem_free(j.soft);
    return status;
}
