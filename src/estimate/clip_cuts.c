/* Cuts of a video: a fixed camera sees little change from frame to frame, and everything change at a cut. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/clip_inside.h"

/* A cut changes the picture by more than this, on the mean of its cells, and by more than so many times what
 * changes within `reach_s` of it. A picture that comes back within `flash_s` was a flash or a fault. */
static const double change_min = 0.08, change_times = 4, reach_s = 0.5, flash_s = 0.2, same_share = 0.6;
enum { REACH_MIN = 5 }; /* frames */

void clip_thumbnail_make(const image_u8 *picture, clip_thumbnail *out) {
    for (int y = 0; y < CLIP_CELLS; y++)
        for (int x = 0; x < CLIP_CELLS; x++) {
            /* a picture that is smaller than the cells gives some the same pixels */
            const int x0 = picture->width * x / CLIP_CELLS, y0 = picture->height * y / CLIP_CELLS;
            int x1 = picture->width * (x + 1) / CLIP_CELLS, y1 = picture->height * (y + 1) / CLIP_CELLS;
            int64_t sum[3] = {0};
            if (x1 == x0) x1++;
            if (y1 == y0) y1++;
            for (int v = y0; v < y1; v++)
                for (int u = x0; u < x1; u++)
                    for (int k = 0; k < 3; k++)
                        sum[k] += picture->data[3 * ((size_t)v * (size_t)picture->width + (size_t)u) + k];
            for (int k = 0; k < 3; k++)
                out->rgb[y * CLIP_CELLS + x][k] = (uint8_t)(sum[k] / ((int64_t)(x1 - x0) * (y1 - y0)));
        }
}

/* The mean difference of colours, 0 to 1. */
static double change(const clip_thumbnail *a, const clip_thumbnail *b) {
    int64_t sum = 0;
    for (int i = 0; i < CLIP_CELLS * CLIP_CELLS; i++)
        for (int k = 0; k < 3; k++) sum += abs(a->rgb[i][k] - b->rgb[i][k]);
    return (double)sum / (CLIP_CELLS * CLIP_CELLS * 3 * 255);
}

static int frames_in(double seconds, double fps, int min) {
    const double n = ceil(seconds * fps);
    return n > min ? (int)n : min;
}

bool clip_cut_at(const clip_track *t, int n, int end) {
    const clip_thumbnail *all = t->thumbnail;
    if (n < 1) return false;
    const double here = change(&all[n - 1], &all[n]);
    if (!(here > change_min)) return false;
    const int reach = frames_in(reach_s, t->fps, REACH_MIN);
    double sum = 0;
    int count = 0;
    for (int i = n > reach ? n - reach : 1; i < end && i <= n + reach; i++) {
        const double d = i == n ? 0 : change(&all[i - 1], &all[i]);
        sum += d;
        count += d > 0; /* a repeated picture says nothing */
    }
    return count == 0 || here * count > change_times * sum; /* all else stands still, or changes less */
}

/* Whether a picture shortly before frame n is seen again shortly after it. */
static bool comes_back(const clip_track *t, int n) {
    const clip_thumbnail *all = t->thumbnail;
    const double here = change(&all[n - 1], &all[n]);
    const int reach = frames_in(flash_s, t->fps, 1);
    for (int a = n > reach ? n - reach : 0; a < n; a++)
        for (int b = n; b < t->count && b < n + reach; b++)
            if (change(&all[a], &all[b]) < same_share * here) return true;
    return false;
}

void clip_keep_shot(clip_track *t) {
    int begin = 0, seen = 0, best_seen = -1, best[2] = {0, t->count};
    t->cuts = 0;
    for (int i = 0; i <= t->count; i++) {
        const bool cut = i < t->count && clip_cut_at(t, i, t->count) && !comes_back(t, i);
        if (cut || i == t->count) {
            if (seen > best_seen) best_seen = seen, best[0] = begin, best[1] = i;
            t->cuts += cut;
            begin = i, seen = 0;
        }
        if (i < t->count) seen += t->frame[i] != NULL;
    }
    t->read = t->count;
    t->start = best[0];
    for (int i = 0; i < t->count; i++)
        if (i < best[0] || i >= best[1]) mem_free(t->frame[i]);
    t->count = best[1] - best[0];
    memmove(t->frame, t->frame + best[0], (size_t)t->count * sizeof *t->frame);
    memmove(t->repeated, t->repeated + best[0], (size_t)t->count * sizeof *t->repeated);
    memmove(t->thumbnail, t->thumbnail + best[0], (size_t)t->count * sizeof *t->thumbnail);
    if (t->count) t->repeated[0] = false; /* of a picture that is not there */
}
