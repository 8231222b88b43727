/* Means over areas: source rows are read one at a time, summed down by their share of the target's
 * row, then across. */
#include "estimate/shrink.h"

#include <math.h>
#include <string.h>

typedef struct {
    shrink_row read;
    const void *user;
    int width, height;
    sherf_image *out;
    float *rows; /* two per thread: as read, and summed down */
} shrinking;

/* Weight of source pixel i in target pixel `to`, which covers [to, to + 1) * scale. */
static float share(int to, double scale, int i) {
    const double from = fmax(to * scale, i), end = fmin((to + 1) * scale, i + 1.);
    return end > from ? (float)((end - from) / scale) : 0;
}

static void across(const shrinking *s, const float *row, float *out) {
    const int channels = s->out->channels;
    const double scale = (double)s->width / s->out->width;
    for (int x = 0; x < s->out->width; x++, out += channels) {
        for (int k = 0; k < channels; k++) out[k] = 0;
        for (int u = (int)(x * scale); u < (x + 1) * scale && u < s->width; u++) {
            const float weight = share(x, scale, u);
            for (int k = 0; k < channels; k++) out[k] += weight * row[u * channels + k];
        }
    }
}

static void shrink_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const shrinking *s = arg;
    const double scale = (double)s->height / s->out->height;
    const size_t values = (size_t)s->width * (size_t)s->out->channels;
    float *read = s->rows + 2 * (size_t)thread * values, *sum = read + values;
    for (int y = (int)begin; y < end; y++) {
        memset(sum, 0, values * sizeof *sum);
        for (int v = (int)(y * scale); v < (y + 1) * scale && v < s->height; v++) {
            const float weight = share(y, scale, v);
            s->read(s->user, v, read);
            for (size_t i = 0; i < values; i++) sum[i] += weight * read[i];
        }
        across(s, sum, s->out->data + (size_t)y * (size_t)s->out->width * (size_t)s->out->channels);
    }
}

sherf_status picture_shrink(context *c, shrink_row read, const void *user, int width, int height,
                            sherf_image *out) {
    const size_t pixel = (size_t)out->channels * sizeof(float);
    out->data = mem_alloc(c, (size_t)out->width * (size_t)out->height, pixel);
    float *rows = mem_alloc(c, 2 * (size_t)c->threads * (size_t)width, pixel);
    if (out->data && rows) {
        shrinking s = {read, user, width, height, out, rows};
        parallel_for(c, out->height, 8, shrink_rows, &s);
    }
    mem_free(rows);
    return out->data && rows ? SHERF_OK : SHERF_NO_MEMORY;
}
