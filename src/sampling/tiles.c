/* Points in tiles, and their compositing: the frames' fast form of tensor/ref/spatial_composite.inc. */
#include "sampling/tiles.h"

#include <math.h>
#include <stdatomic.h>
#include <string.h>

void point_tile_fill(const point_set *points, const int64_t *index, int64_t first, int count, point_tile *t) {
    t->count = count;
    for (int p = 0; p < count; p++) {
        int64_t i = index ? index[p] : first + p;
        for (int k = 0; k < 3; k++) {
            t->position[k][p] = points->canonical[3 * i + k];
            t->direction[k][p] = points->direction_canonical[3 * i + k];
        }
        t->pixel[0][p] = points->observed_px[2 * i];
        t->pixel[1][p] = points->observed_px[2 * i + 1];
    }
    for (int p = count; p < POINT_TILE; p++)
        for (int k = 0; k < 3; k++) t->position[k][p] = t->direction[k][p] = t->pixel[k & 1][p] = 0;
}

typedef struct {
    context *c;
    const tile_source *source; /* NULL: known_rgb and known_sigma have the results */
    const point_set *points;
    char *scratch; /* one part a thread */
    size_t part;
    atomic_llong next; /* the next piece of work that no thread has taken */
    int64_t pieces;
    float *rgb, *sigma;
    const float *known_rgb, *known_sigma;
    /* frames only */
    const ray_bundle *rays;
    const float *background;
    float depth_min, depth_max;
    bool early_stop;
    sherf_frame *frame;
} work;

static int64_t next_piece(work *w) {
    if (cancelled(w->c)) return -1;
    int64_t i = atomic_fetch_add_explicit(&w->next, 1, memory_order_relaxed);
    return i < w->pieces ? i : -1;
}

static void run_tiles(void *arg, int64_t begin, int64_t end, int thread) {
    work *w = arg;
    void *scratch = w->scratch + (size_t)thread * w->part;
    point_tile t;
    for (int64_t i; (i = next_piece(w)) >= 0;) {
        int64_t first = i * POINT_TILE, left = w->points->count - first;
        point_tile_fill(w->points, NULL, first, left < POINT_TILE ? (int)left : POINT_TILE, &t);
        w->source->answer(w->source->self, &t, scratch);
        for (int p = 0; p < t.count; p++) {
            for (int k = 0; k < 3; k++) w->rgb[3 * (first + p) + k] = t.out[k][p];
            w->sigma[first + p] = t.out[3][p];
        }
    }
}

static sherf_status start_work(context *c, const tile_source *source, const point_set *points, size_t extra,
                               work *w) {
    if (source && points->count && (!points->observed_px || !points->direction_canonical))
        return failure(c, SHERF_BAD_ARGUMENT, "the points lack directions or observed pixels");
    w->c = c;
    w->source = source;
    w->points = points;
    w->part = ((source ? source->scratch_bytes : 0) + extra + 4095) / 4096 * 4096;
    w->scratch = mem_alloc(c, (size_t)c->threads, w->part);
    return w->scratch ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status do_work(work *w, range_function f) {
    parallel_for(w->c, w->c->threads, 1, f, w);
    mem_free(w->scratch);
    return cancelled(w->c) ? failure(w->c, SHERF_CANCELLED, "cancelled") : SHERF_OK;
}

sherf_status tiles_run(context *c, const tile_source *source, const point_set *points, float *rgb,
                       float *sigma) {
    work w = {.rgb = rgb, .sigma = sigma, .pieces = (points->count + POINT_TILE - 1) / POINT_TILE};
    sherf_status status = start_work(c, source, points, 0, &w);
    return status ? status : do_work(&w, run_tiles);
}

/* ---- frames: blocks of rays, so that the points of a tile lie close together ---- */
enum { BLOCK_SIDE = 16, BLOCK_RAYS = BLOCK_SIDE * BLOCK_SIDE, CHUNK = 4 };
static const float opaque = 1e-3f; /* transmittance at which the rest of a ray is dropped */

/* A ray's way from front to back (network.md 6). */
typedef struct {
    int64_t ray, at, end;
    float near, far, step, delta; /* depths; step in depth and in metres */
    float transmittance, color[3], opacity, depth;
} ray_state;

/* What the block's thread keeps besides the tile's scratch. */
typedef struct {
    ray_state state[BLOCK_RAYS];
    int64_t index[POINT_TILE];
    int16_t owner[POINT_TILE];
    int16_t active[BLOCK_RAYS]; /* rays with points to come */
    point_tile tile;
} block_space;

static ray_state start_ray(const work *w, int64_t ray) {
    const float *d = w->rays->direction + 3 * ray;
    float near = w->rays->near[ray], far = w->rays->far[ray];
    float step = w->points->samples > 1 ? (far - near) / (float)(w->points->samples - 1) : 0;
    return (ray_state){.ray = ray,
                       .at = w->points->first[ray],
                       .end = w->points->first[ray + 1],
                       .near = near,
                       .far = far,
                       .step = step,
                       .delta = step * sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]),
                       .transmittance = 1};
}

static void composite_tile(const work *w, block_space *b) {
    int last = w->points->samples - 1;
    for (int p = 0; p < b->tile.count; p++) {
        ray_state *s = &b->state[b->owner[p]];
        float sigma = b->tile.out[3][p];
        if (!(sigma > 0)) continue;
        int sample = w->points->sample[b->index[p]];
        float alpha = 1.0f - expf(-sigma * (sample == last ? 1e10f : s->delta));
        float weight = alpha * s->transmittance;
        for (int k = 0; k < 3; k++) s->color[k] += weight * b->tile.out[k][p];
        s->opacity += weight;
        s->depth += weight * (sample == last ? s->far : s->near + s->step * (float)sample);
        s->transmittance *= 1.0f - alpha + 1e-10f;
    }
}

static void look_up(const work *w, block_space *b) {
    for (int p = 0; p < b->tile.count; p++) {
        for (int k = 0; k < 3; k++) b->tile.out[k][p] = w->known_rgb[3 * b->index[p] + k];
        b->tile.out[3][p] = w->known_sigma[b->index[p]];
    }
}

static void flush(const work *w, block_space *b, void *scratch) {
    if (!b->tile.count) return;
    if (w->source) {
        point_tile_fill(w->points, b->index, 0, b->tile.count, &b->tile);
        w->source->answer(w->source->self, &b->tile, scratch);
    } else {
        look_up(w, b);
    }
    composite_tile(w, b);
    b->tile.count = 0;
}

static void write_ray(const work *w, const ray_state *s) {
    sherf_frame *f = w->frame;
    for (int k = 0; k < 3; k++)
        f->color.data[3 * s->ray + k] = s->color[k] + (1.0f - s->opacity) * w->background[k];
    f->opacity.data[s->ray] = s->opacity;
    float depth = s->opacity > 0 ? s->depth / s->opacity : w->depth_max;
    f->depth.data[s->ray] = fminf(fmaxf(depth, w->depth_min), w->depth_max);
}

/* As write_ray, for a ray without points; its direction and range need not be read. */
static void write_nothing(const work *w, int64_t ray) {
    sherf_frame *f = w->frame;
    for (int k = 0; k < 3; k++) f->color.data[3 * ray + k] = w->background[k];
    f->opacity.data[ray] = 0;
    f->depth.data[ray] = w->depth_max;
}

/* The block's rays that have points, into `active`; the others are finished. */
static int start_block(const work *w, block_space *b, int64_t block) {
    const int width = w->rays->width, height = w->rays->height;
    const int across = (width + BLOCK_SIDE - 1) / BLOCK_SIDE;
    const int x0 = (int)(block % across) * BLOCK_SIDE, y0 = (int)(block / across) * BLOCK_SIDE;
    int count = 0;
    for (int y = y0; y < y0 + BLOCK_SIDE && y < height; y++)
        for (int x = x0; x < x0 + BLOCK_SIDE && x < width; x++) {
            const int64_t ray = (int64_t)y * width + x;
            if (w->points->first[ray] == w->points->first[ray + 1]) {
                write_nothing(w, ray);
                continue;
            }
            b->state[count] = start_ray(w, ray);
            b->active[count] = (int16_t)count;
            count++;
        }
    return count;
}

/* Takes the points ray by ray. With early_stop it takes rounds of CHUNK points per ray, so that opaque rays
 * drop out; a tile that a round does not fill is filled by the next. Points of a ray stay in order, whichever
 * tile they fall into. */
static void run_blocks(void *arg, int64_t begin, int64_t end, int thread) {
    work *w = arg;
    char *scratch = w->scratch + (size_t)thread * w->part;
    block_space *b = (block_space *)scratch;
    scratch += (sizeof *b + 63) / 64 * 64;
    const int64_t chunk = w->early_stop ? CHUNK : INT64_MAX / 2;
    b->tile.count = 0;
    for (int64_t i; (i = next_piece(w)) >= 0;) {
        const int count = start_block(w, b, i);
        for (int active = count, still; active; active = still) {
            still = 0;
            for (int k = 0; k < active; k++) {
                const int16_t r = b->active[k];
                ray_state *s = &b->state[r];
                if (w->early_stop && s->transmittance < opaque) continue;
                const int64_t stop = s->end - s->at > chunk ? s->at + chunk : s->end;
                for (; s->at < stop; s->at++) {
                    b->owner[b->tile.count] = r;
                    b->index[b->tile.count++] = s->at;
                    if (b->tile.count == POINT_TILE) flush(w, b, scratch);
                }
                if (s->at < s->end) b->active[still++] = r;
            }
        }
        flush(w, b, scratch);
        for (int r = 0; r < count; r++) write_ray(w, &b->state[r]);
    }
}

static sherf_status shape_image(context *c, int width, int height, int channels, sherf_image *image) {
    if (image->data && image->width == width && image->height == height && image->channels == channels)
        return SHERF_OK;
    mem_free(image->data);
    *image = (sherf_image){0};
    image->data = mem_alloc(c, (size_t)width * (size_t)height, (size_t)channels * sizeof(float));
    if (!image->data) return SHERF_NO_MEMORY;
    image->width = width;
    image->height = height;
    image->channels = channels;
    return SHERF_OK;
}

sherf_status frame_shape(context *c, int width, int height, sherf_frame *frame) {
    sherf_status status = shape_image(c, width, height, 3, &frame->color);
    if (!status) status = shape_image(c, width, height, 1, &frame->opacity);
    if (!status) status = shape_image(c, width, height, 1, &frame->depth);
    return status;
}

static sherf_status render(context *c, const tile_source *source, const ray_bundle *rays,
                           const point_set *points, work *w, sherf_frame *frame) {
    int64_t count = (int64_t)rays->width * rays->height;
    if (points->rays != count || points->samples < 1)
        return failure(c, SHERF_BAD_ARGUMENT, "points of %lld rays for a picture of %lld",
                       (long long)points->rays, (long long)count);
    w->rays = rays;
    w->frame = frame;
    float depth_min = INFINITY, depth_max = -INFINITY;
#pragma omp parallel for reduction(min : depth_min) reduction(max : depth_max) num_threads(c->threads)
    for (int64_t i = 0; i < count; i++) {
        const float near = rays->near[i], far = rays->far[i], low = near < far ? near : far;
        const float high = near < far ? far : near;
        depth_min = low < depth_min ? low : depth_min;
        depth_max = high > depth_max ? high : depth_max;
    }
    w->depth_min = depth_min;
    w->depth_max = depth_max;
    w->pieces = (int64_t)((rays->width + BLOCK_SIDE - 1) / BLOCK_SIDE) *
                ((rays->height + BLOCK_SIDE - 1) / BLOCK_SIDE);
    sherf_status status = frame_shape(c, rays->width, rays->height, frame);
    if (!status) status = start_work(c, source, points, sizeof(block_space) + 64, w);
    if (status) return status;
    frame->points = points->count;
    return do_work(w, run_blocks);
}

sherf_status tiles_render(context *c, const tile_source *source, const ray_bundle *rays,
                          const point_set *points, const float background[3], bool early_stop,
                          sherf_frame *frame) {
    work w = {.background = background, .early_stop = early_stop && source->stops_early};
    return render(c, source, rays, points, &w, frame);
}

sherf_status points_render(context *c, const ray_bundle *rays, const point_set *points, const float *rgb,
                           const float *sigma, const float background[3], sherf_frame *frame) {
    work w = {.background = background, .known_rgb = rgb, .known_sigma = sigma};
    return render(c, NULL, rays, points, &w, frame);
}
