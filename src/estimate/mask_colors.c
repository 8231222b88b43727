/* mask: the person's own colours at the edge of the mask. They are carried outwards, ring by ring, from
 * pixels that lie safely inside. The camera's colours at the edge are not used, since nobody knows how much
 * of them is background. */
#include <math.h>
#include <string.h>

#include "estimate/mask.h"

enum { OUTSIDE, KNOWN, WANTED, RINGS_MAX = 512 };
static const float all_of_it = 0.98f, none_of_it = 0.004f;

typedef struct {
    const sherf_image *mask;
    uint8_t *along, *state;
    int reach;
} rim;

/* 1 where everything within reach along the row is the person. */
static void rows_erode(void *arg, int64_t begin, int64_t end, int thread) {
    const rim *r = arg;
    const int width = r->mask->width;
    for (int64_t y = begin; y < end; y++) {
        const float *in = r->mask->data + (size_t)y * width;
        uint8_t *out = r->along + (size_t)y * width;
        int since = r->reach; /* since the last outside pixel; the person may continue beyond the photo */
        for (int x = 0; x < width; x++) {
            since = in[x] < all_of_it ? -1 : since + 1;
            out[x] = since >= r->reach;
        }
        since = r->reach;
        for (int x = width - 1; x >= 0; x--) {
            since = in[x] < all_of_it ? -1 : since + 1;
            out[x] &= since >= r->reach;
        }
    }
}

static void columns_erode(void *arg, int64_t begin, int64_t end, int thread) {
    const rim *r = arg;
    const int width = r->mask->width, height = r->mask->height;
    for (int64_t y = begin; y < end; y++) {
        uint8_t *out = r->state + (size_t)y * width;
        const float *in = r->mask->data + (size_t)y * width;
        memset(out, KNOWN, (size_t)width);
        for (int64_t v = y - r->reach; v <= y + r->reach; v++)
            if (v >= 0 && v < height)
                for (int x = 0; x < width; x++) out[x] &= r->along[(size_t)v * width + x];
        for (int x = 0; x < width; x++)
            if (!out[x] && in[x] > none_of_it) out[x] = WANTED;
    }
}

/* The mean of the known neighbours' colours; false: there are none. */
static bool neighbours_mean(const rim *r, const float *colors, int x, int y, float out[3]) {
    const int width = r->mask->width, height = r->mask->height;
    float sum[4] = {0};
    for (int v = y - 1; v <= y + 1; v++)
        for (int u = x - 1; u <= x + 1; u++) {
            if (u < 0 || v < 0 || u >= width || v >= height) continue;
            const size_t at = (size_t)v * width + u;
            if (r->state[at] != KNOWN) continue;
            for (int k = 0; k < 3; k++) sum[k] += colors[3 * at + k];
            sum[3]++;
        }
    for (int k = 0; k < 3 && sum[3] > 0; k++) out[k] = sum[k] / sum[3];
    return sum[3] > 0;
}

typedef struct {
    const rim *rim;
    const size_t *wanted;
    bool *found; /* one per wanted pixel */
    float *colors;
} ringing;

static void ring_part(void *arg, int64_t begin, int64_t end, int thread) {
    const ringing *g = arg;
    const size_t width = (size_t)g->rim->mask->width;
    for (int64_t i = begin; i < end; i++) {
        const size_t at = g->wanted[i];
        g->found[i] =
            neighbours_mean(g->rim, g->colors, (int)(at % width), (int)(at / width), g->colors + 3 * at);
    }
}

/* Pixels that no ring reaches keep the photo's colours. */
static void rings_fill(context *c, const rim *r, size_t *wanted, bool *found, size_t count, float *colors) {
    for (int ring = 0; ring < RINGS_MAX && count; ring++) {
        ringing g = {r, wanted, found, colors};
        size_t left = 0;
        parallel_for(c, (int64_t)count, 4096, ring_part, &g);
        for (size_t i = 0; i < count; i++) {
            const size_t at = wanted[i];
            if (found[i])
                r->state[at] = KNOWN;
            else
                wanted[left++] = at;
        }
        if (left == count) return;
        count = left;
    }
}

typedef struct {
    const float *from;
    float *to;
    size_t row_values;
} copying;

static void rows_copy(void *arg, int64_t begin, int64_t end, int thread) {
    const copying *k = arg;
    memcpy(k->to + (size_t)begin * k->row_values, k->from + (size_t)begin * k->row_values,
           (size_t)(end - begin) * k->row_values * sizeof(float));
}

sherf_status mask_free_colors(context *c, const sherf_image *photo, const sherf_image *mask,
                              sherf_image *out) {
    const size_t n = (size_t)photo->width * photo->height;
    const int longest = photo->width > photo->height ? photo->width : photo->height;
    *out = (sherf_image){0};
    if (photo->channels != 3 || mask->channels != 1 || mask->width != photo->width ||
        mask->height != photo->height)
        return failure(c, SHERF_BAD_ARGUMENT, "a mask of %d x %d x %d for a photo of %d x %d x %d",
                       mask->width, mask->height, mask->channels, photo->width, photo->height,
                       photo->channels);
    /* edges are wider in large photos: 2 pixels at 512, 6 at 4000 */
    rim r = {mask, mem_alloc(c, n, 1), mem_alloc(c, n, 1), 1 + longest / 800};
    if (r.reach < 2) r.reach = 2;
    if (r.reach > 6) r.reach = 6;
    size_t *wanted = NULL, count = 0;
    bool *found = NULL;
    float *colors = mem_alloc(c, n, 3 * sizeof *colors);
    sherf_status status = SHERF_NO_MEMORY;
    if (!r.along || !r.state || !colors) goto done;
    parallel_for(c, photo->height, 16, rows_erode, &r);
    parallel_for(c, photo->height, 16, columns_erode, &r);
    for (size_t i = 0; i < n; i++) count += r.state[i] == WANTED;
    wanted = mem_alloc(c, count + 1, sizeof *wanted);
    found = mem_alloc(c, count + 1, sizeof *found);
    if (!wanted || !found) goto done;
    count = 0;
    for (size_t i = 0; i < n; i++)
        if (r.state[i] == WANTED) wanted[count++] = i;
    copying k = {photo->data, colors, (size_t)photo->width * 3};
    parallel_for(c, photo->height, 16, rows_copy, &k);
    rings_fill(c, &r, wanted, found, count, colors);
    *out = (sherf_image){photo->width, photo->height, 3, colors};
    colors = NULL;
    status = SHERF_OK;
done:
    mem_free(r.along);
    mem_free(r.state);
    mem_free(wanted);
    mem_free(found);
    mem_free(colors);
    return status;
}
