/* BlazePose's detector on a photo and on ever smaller squares of it: decodes its anchors and keeps the best
 * of overlapping boxes. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "estimate/detect.h"
#include "estimate/region.h"

/* A lower score is no person; of two boxes that overlap by more than the second number the better one
 * stays. */
static const float score_min = .5f, overlap_max = .3f;
/* In a closer look, only people are accepted whose region is at most this share of the square: of larger ones
 * it showed only a piece. If nobody in the photo is larger than `small` of it, an even closer look follows.
 */
static const float whole_max = 1.3f, small = .5f;
/* Photos are scaled down to about this: a quarter of it is twice the network's input. */
enum { KEPT_MAX = 256, LOOKED_AT_SIDE_MAX = 1792, SHORT_SIDE_MIN = 32, REFINED_MAX = 8 };

typedef struct {
    detection item[KEPT_MAX];
    int count;
} found;

static float area(const float box[4]) {
    return fmaxf(box[2] - box[0], 0) * fmaxf(box[3] - box[1], 0);
}

/* Intersection over union. */
static float overlap(const float a[4], const float b[4]) {
    const float both[4] = {fmaxf(a[0], b[0]), fmaxf(a[1], b[1]), fminf(a[2], b[2]), fminf(a[3], b[3])};
    const float shared = area(both);
    return shared > 0 ? shared / (area(a) + area(b) - shared) : 0;
}

/* Anchors: strides 8, 16, 32 with 2, 2, 6 per cell, row by row; u and v of the cell's middle. */
static void anchor(int row, float centre[2]) {
    static const struct { int cells, each; } level[] = {{28, 2}, {14, 2}, {7, 6}};
    int k = 0;
    while (row >= level[k].cells * level[k].cells * level[k].each)
        row -= level[k].cells * level[k].cells * level[k].each, k++;
    const int cell = row / level[k].each;
    centre[0] = ((float)(cell % level[k].cells) + .5f) / (float)level[k].cells;
    centre[1] = ((float)(cell / level[k].cells) + .5f) / (float)level[k].cells;
}

/* A row: logit, box (centre, size), key points (middle of the hips, reach, and two of the upper body). */
static bool read_row(const float *row, int number, const photo_region *looked_at, float side_max,
                     detection *out) {
    float centre[2], point[2][2];
    for (int i = 0; i < DETECTOR_COLUMNS; i++)
        if (!isfinite(row[i])) return false;
    out->score = 1 / (1 + expf(-row[0]));
    if (!(out->score >= score_min)) return false;
    anchor(number, centre);
    const float unit = 1.f / DETECTOR_SIDE;
    for (int k = 0; k < 2; k++)
        region_place(looked_at, centre[0] + unit * row[5 + 2 * k], centre[1] + unit * row[6 + 2 * k],
                     point[k]);
    out->region = region_about(point[0], point[1]);
    region_place(looked_at, centre[0] + unit * (row[1] - .5f * row[3]),
                 centre[1] + unit * (row[2] - .5f * row[4]), out->box_px);
    region_place(looked_at, centre[0] + unit * (row[1] + .5f * row[3]),
                 centre[1] + unit * (row[2] + .5f * row[4]), out->box_px + 2);
    return area(out->box_px) > 0 && out->region.side_px > 8 &&
           out->region.side_px < side_max * looked_at->side_px;
}

static int by_score(const void *x, const void *y) {
    const detection *a = x, *b = y;
    return a->score > b->score ? -1 : a->score < b->score;
}

static int by_size(const void *x, const void *y) {
    const detection *a = x, *b = y;
    if (a->region.side_px != b->region.side_px) return a->region.side_px > b->region.side_px ? -1 : 1;
    return by_score(x, y);
}

/* Adds a detection unless an overlapping one is better; it replaces worse ones. */
static void keep(found *f, const detection *d) {
    for (int i = 0; i < f->count; i++)
        if (overlap(f->item[i].box_px, d->box_px) > overlap_max && f->item[i].score >= d->score) return;
    int n = 0;
    for (int i = 0; i < f->count; i++)
        if (overlap(f->item[i].box_px, d->box_px) <= overlap_max) f->item[n++] = f->item[i];
    f->count = n;
    if (n < KEPT_MAX) f->item[f->count++] = *d;
}

static sherf_status look_at(context *c, const pose_networks *n, const sherf_image *photo,
                            const photo_region *region, float side_max, found *f) {
    sherf_status status = SHERF_NO_MEMORY;
    const float *rows;
    detection d, *better = mem_alloc(c, DETECTOR_ROWS, sizeof *better);
    arena *memory = arena_create(c);
    float *input =
        memory ? arena_alloc(c, memory, (size_t)DETECTOR_SIDE * DETECTOR_SIDE * 3, sizeof *input) : NULL;
    int count = 0;
    if (!better || !input) goto done;
    status = region_sample(c, photo, region, DETECTOR_SIDE, true, 2, -1, input);
    if (status == SHERF_OK) status = graph_run(c, n->detector, input, memory, &rows);
    if (status != SHERF_OK) goto done;
    for (int i = 0; i < DETECTOR_ROWS; i++)
        if (read_row(rows + (size_t)i * DETECTOR_COLUMNS, i, region, side_max, &d)) better[count++] = d;
    qsort(better, (size_t)count, sizeof *better, by_score);
    for (int i = 0; i < count; i++) keep(f, &better[i]);
done:
    mem_free(better);
    if (memory) arena_free(memory);
    return status;
}

/* Squares of this side over the whole photo, each overlapping its neighbours by half. */
static sherf_status look_closer(context *c, const pose_networks *n, const sherf_image *photo, float side_px,
                                found *f) {
    const float size[2] = {(float)photo->width, (float)photo->height};
    int tiles[2];
    sherf_status status = SHERF_OK;
    for (int k = 0; k < 2; k++)
        tiles[k] = size[k] > side_px ? (int)ceilf(2 * (size[k] / side_px - 1)) + 1 : 1;
    for (int i = 0; i < tiles[0] * tiles[1] && status == SHERF_OK; i++) {
        const int at[2] = {i % tiles[0], i / tiles[0]};
        photo_region r = {.side_px = side_px};
        for (int k = 0; k < 2; k++)
            r.centre_px[k] =
                tiles[k] > 1
                    ? .5f * side_px + (size[k] - side_px) * (float)at[k] / (float)(tiles[k] - 1) - .5f
                    : .5f * size[k] - .5f;
        status = look_at(c, n, photo, &r, whole_max, f);
    }
    return status;
}

static float largest(const found *f) {
    float side = 0;
    for (int i = 0; i < f->count; i++) side = fmaxf(side, f->item[i].region.side_px);
    return side;
}

/* Looks at each small person alone: rotation and size are estimated badly from far away. */
static sherf_status look_at_each(context *c, const pose_networks *n, const sherf_image *photo, float side_max,
                                 found *f) {
    detection small_one[REFINED_MAX];
    int count = 0;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < f->count && count < REFINED_MAX; i++)
        if (f->item[i].region.side_px < side_max) small_one[count++] = f->item[i];
    for (int i = 0; i < count && status == SHERF_OK; i++) {
        photo_region r = small_one[i].region;
        r.side_px *= 1.6f;
        r.angle_rad = 0;
        status = look_at(c, n, photo, &r, whole_max, f);
    }
    return status;
}

/* The network detects the largest person of a picture well, and others only if they are about as large in its
 * input. */
static sherf_status look(context *c, const pose_networks *n, const sherf_image *photo, found *f) {
    const float width = (float)photo->width, height = (float)photo->height, longest = fmaxf(width, height);
    const photo_region whole = {.centre_px = {.5f * (width - 1), .5f * (height - 1)}, .side_px = longest};
    sherf_status status = look_at(c, n, photo, &whole, 8, f);
    if (fminf(width, height) < SHORT_SIDE_MIN || longest < DETECTOR_SIDE / 2) return status;
    if (status == SHERF_OK) status = look_closer(c, n, photo, longest / 2, f);
    if (status == SHERF_OK && largest(f) >= small * longest) return look_at_each(c, n, photo, longest / 4, f);
    if (status == SHERF_OK) status = look_closer(c, n, photo, longest / 4, f);
    return status;
}

sherf_status people_detect(context *c, const pose_networks *n, const sherf_image *photo, detection *out,
                           int *count) {
    const int longest = photo->width > photo->height ? photo->width : photo->height;
    const int step = (longest + LOOKED_AT_SIDE_MAX - 1) / LOOKED_AT_SIDE_MAX;
    sherf_image shrunk = {0};
    *count = 0;
    found *f = mem_zero(c, 1, sizeof *f);
    if (!f) return SHERF_NO_MEMORY;
    sherf_status status = step > 1 ? photo_shrink(c, photo, step, &shrunk) : SHERF_OK;
    if (status == SHERF_OK) status = look(c, n, step > 1 ? &shrunk : photo, f);
    if (status == SHERF_OK) {
        qsort(f->item, (size_t)f->count, sizeof *f->item, by_size);
        *count = f->count < DETECTIONS_MAX ? f->count : DETECTIONS_MAX;
        memcpy(out, f->item, (size_t)*count * sizeof *out);
    }
    const float scale = (float)step, shift = .5f * (float)(step - 1);
    for (int i = 0; i < *count; i++) {
        for (int k = 0; k < 4; k++) out[i].box_px[k] = scale * out[i].box_px[k] + shift;
        for (int k = 0; k < 2; k++) out[i].region.centre_px[k] = scale * out[i].region.centre_px[k] + shift;
        out[i].region.side_px *= scale;
    }
    mem_free(shrunk.data);
    mem_free(f);
    return status;
}
