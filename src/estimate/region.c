/* Turned squares of a photo: their place in it, and their pixels as means over square cells with bilinear
 * sampling between these. */
#include <math.h>
#include <string.h>

#include "estimate/region.h"

void region_place(const photo_region *region, float u, float v, float place_px[2]) {
    const float cosine = cosf(region->angle_rad), sine = sinf(region->angle_rad);
    const float x = region->side_px * (u - .5f), y = region->side_px * (v - .5f);
    place_px[0] = region->centre_px[0] + cosine * x - sine * y;
    place_px[1] = region->centre_px[1] + sine * x + cosine * y;
}

void region_find(const photo_region *region, const float place_px[2], float uv[2]) {
    const float cosine = cosf(region->angle_rad), sine = sinf(region->angle_rad);
    const float x = place_px[0] - region->centre_px[0], y = place_px[1] - region->centre_px[1];
    uv[0] = (cosine * x + sine * y) / region->side_px + .5f;
    uv[1] = (cosine * y - sine * x) / region->side_px + .5f;
}

photo_region region_about(const float middle_px[2], const float top_px[2]) {
    const float right = top_px[0] - middle_px[0], down = top_px[1] - middle_px[1];
    return (photo_region){.centre_px = {middle_px[0], middle_px[1]},
                          .side_px = 2.5f * hypotf(right, down),
                          .angle_rad = atan2f(right, -down)};
}

/* Means of squares of `step` pixels: cell (i, j) begins at pixel first + step (i, j). */
typedef struct {
    const sherf_image *photo;
    int step, first[2], size[2]; /* across, down */
    bool black;
    float *mean; /* [down, across, 3] */
} cells;

static int clamped(int64_t i, int count) {
    return i < 0 ? 0 : i >= count ? count - 1 : (int)i;
}

/* Adds up the pixels of a row from begin to end that are inside the photo. */
static void add_row(const sherf_image *p, int64_t y, int64_t begin, int64_t end, float sum[3]) {
    const float *row = p->data + (size_t)clamped(y, p->height) * (size_t)p->width * 3;
    for (int64_t x = begin > 0 ? begin : 0; x < end && x < p->width; x++)
        for (int k = 0; k < 3; k++) sum[k] += row[3 * x + k];
}

/* The nearest pixel's colour for those that are not. */
static void add_beside(const sherf_image *p, int64_t y, int64_t begin, int64_t end, float sum[3]) {
    const float *row = p->data + (size_t)clamped(y, p->height) * (size_t)p->width * 3,
                *last = row + 3 * ((size_t)p->width - 1);
    const int64_t left = begin < 0 ? (end < 0 ? end : 0) - begin : 0,
                  right = end > p->width ? end - (begin > p->width ? begin : p->width) : 0;
    for (int k = 0; k < 3; k++) sum[k] += (float)left * row[k] + (float)right * last[k];
}

static void cell_mean(const cells *grid, int i, int j, float *mean) {
    const sherf_image *p = grid->photo;
    const int64_t left = grid->first[0] + (int64_t)i * grid->step,
                  top = grid->first[1] + (int64_t)j * grid->step;
    float sum[3] = {0};
    for (int64_t y = top; y < top + grid->step; y++) {
        if (grid->black && (y < 0 || y >= p->height)) continue;
        add_row(p, y, left, left + grid->step, sum);
        if (!grid->black) add_beside(p, y, left, left + grid->step, sum);
    }
    for (int k = 0; k < 3; k++) mean[k] = sum[k] / ((float)grid->step * (float)grid->step);
}

static void cell_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const cells *grid = arg;
    for (int64_t j = begin; j < end; j++)
        for (int i = 0; i < grid->size[0]; i++)
            cell_mean(grid, i, (int)j, grid->mean + ((size_t)j * (size_t)grid->size[0] + (size_t)i) * 3);
}

/* Bilinear, at a place in the photo; the cells reach far enough. */
static void between_cells(const cells *grid, const float place_px[2], float sum[3]) {
    float at[2];
    int low[2], high[2];
    for (int k = 0; k < 2; k++) {
        at[k] = (place_px[k] - (float)grid->first[k] - .5f * (float)(grid->step - 1)) / (float)grid->step;
        low[k] = clamped((int64_t)floorf(at[k]), grid->size[k]);
        high[k] = clamped(low[k] + 1, grid->size[k]);
        at[k] = fminf(fmaxf(at[k] - (float)low[k], 0), 1);
    }
    const float *above = grid->mean + (size_t)low[1] * (size_t)grid->size[0] * 3,
                *below = grid->mean + (size_t)high[1] * (size_t)grid->size[0] * 3;
    for (int k = 0; k < 3; k++) {
        const float a = above[3 * low[0] + k], b = above[3 * high[0] + k], c = below[3 * low[0] + k],
                    d = below[3 * high[0] + k];
        const float upper = a + (b - a) * at[0], lower = c + (d - c) * at[0];
        sum[k] += upper + (lower - upper) * at[1];
    }
}

typedef struct {
    const cells *grid;
    const photo_region *region;
    int side;
    float scale, shift, *out;
} sampling;

static void sample_rows(void *arg, int64_t begin, int64_t end, int thread) {
    const sampling *s = arg;
    const bool shrinks = s->region->side_px > (float)s->side;
    const int samples = shrinks ? 2 : 1; /* per side */
    const float part = 1.f / ((float)samples * (float)s->side);
    float corner[2], across[2], down[2]; /* and a whole side from there; region_place at each would be slow */
    region_place(s->region, 0, 0, corner);
    region_place(s->region, 1, 0, across);
    region_place(s->region, 0, 1, down);
    for (int k = 0; k < 2; k++) across[k] -= corner[k], down[k] -= corner[k];
    for (int64_t j = begin; j < end; j++)
        for (int i = 0; i < s->side; i++) {
            float sum[3] = {0}, place_px[2];
            for (int k = 0; k < samples * samples; k++) {
                const int column = i * samples + k % samples, row = (int)j * samples + k / samples;
                const float u = ((float)column + .5f) * part, v = ((float)row + .5f) * part;
                for (int a = 0; a < 2; a++) place_px[a] = corner[a] + u * across[a] + v * down[a];
                between_cells(s->grid, place_px, sum);
            }
            float *out = s->out + ((size_t)j * (size_t)s->side + (size_t)i) * 3;
            for (int k = 0; k < 3; k++) out[k] = s->scale * (sum[k] / (float)(samples * samples)) + s->shift;
        }
}

sherf_status region_sample(context *c, const sherf_image *photo, const photo_region *region, int side,
                           bool black_outside, float scale, float shift, float *out) {
    const float longest = (float)(photo->width > photo->height ? photo->width : photo->height);
    if (photo->channels != 3)
        return failure(c, SHERF_BAD_ARGUMENT, "a photo of %d channels", photo->channels);
    if (!(region->side_px > 0 && region->side_px <= 64 * longest + 64) ||
        !(fabsf(region->centre_px[0]) <= 64 * longest + 64) ||
        !(fabsf(region->centre_px[1]) <= 64 * longest + 64) || !isfinite(region->angle_rad))
        return failure(c, SHERF_BAD_ARGUMENT, "a region far outside the photo");
    cells grid = {.photo = photo, .black = black_outside, .step = (int)(region->side_px / (float)side)};
    if (grid.step < 1) grid.step = 1;
    /* what the turned square covers, and a cell more on every side */
    const float half =
        .5f * region->side_px * (fabsf(cosf(region->angle_rad)) + fabsf(sinf(region->angle_rad)));
    for (int k = 0; k < 2; k++) {
        grid.first[k] = (int)floorf(region->centre_px[k] - half) - grid.step;
        grid.size[k] = (int)ceilf(2 * half / (float)grid.step) + 3;
    }
    grid.mean = mem_alloc(c, (size_t)grid.size[0] * (size_t)grid.size[1] * 3, sizeof *grid.mean);
    if (!grid.mean) return SHERF_NO_MEMORY;
    parallel_for(c, grid.size[1], 8, cell_rows, &grid);
    sampling s = {&grid, region, side, scale, shift, out};
    parallel_for(c, side, 8, sample_rows, &s);
    mem_free(grid.mean);
    return SHERF_OK;
}

/* The mean of a square that extends past the edge uses the pixels inside. */
static void repair_edges(const sherf_image *photo, int step, sherf_image *out) {
    const int right = photo->width - (out->width - 1) * step, low = photo->height - (out->height - 1) * step;
    for (int y = 0; y < out->height; y++)
        for (int x = 0; x < out->width; x++) {
            if (x + 1 < out->width && y + 1 < out->height) continue;
            const int there = (x + 1 < out->width ? step : right) * (y + 1 < out->height ? step : low);
            float *to = out->data + ((size_t)y * (size_t)out->width + (size_t)x) * 3;
            for (int k = 0; k < 3; k++) to[k] *= (float)step * (float)step / (float)there;
        }
}

sherf_status photo_shrink(context *c, const sherf_image *photo, int step, sherf_image *out) {
    *out = (sherf_image){0};
    if (photo->channels != 3)
        return failure(c, SHERF_BAD_ARGUMENT, "a photo of %d channels", photo->channels);
    cells grid = {.photo = photo, .step = step, .black = true};
    grid.size[0] = (photo->width + step - 1) / step;
    grid.size[1] = (photo->height + step - 1) / step;
    grid.mean = mem_alloc(c, (size_t)grid.size[0] * (size_t)grid.size[1] * 3, sizeof *grid.mean);
    if (!grid.mean) return SHERF_NO_MEMORY;
    parallel_for(c, grid.size[1], 8, cell_rows, &grid);
    *out = (sherf_image){grid.size[0], grid.size[1], 3, grid.mean};
    repair_edges(photo, step, out);
    return SHERF_OK;
}
