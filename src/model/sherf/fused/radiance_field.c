/* The radiance field: preparation, dispatch and the loops over tiles. */
#include "model/sherf/fused/radiance_field.h"

#include <math.h>
#include <stdatomic.h>
#include <string.h>

#include "model/sherf/fused/inside.h"

/* ---- creation ---- */
static sherf_status check_sizes(context *c, const point_sizes *s) {
    bool good = s->token_width >= 1 && s->token_width <= 256 && s->feature_channels >= 1 &&
                s->feature_channels <= 3 * s->token_width && s->heads >= 1 && s->heads <= 64 &&
                s->head_width >= 1 && s->head_width <= 256 && s->decoder_width >= 1 &&
                s->decoder_width <= 2048 && s->decoder_depth >= 1 && s->decoder_depth <= POINT_DECODER_MAX &&
                s->decoder_skip < s->decoder_depth - 1 && s->view_width >= 1 && s->view_width <= 2048;
    for (int i = 0; i < POINT_LEVELS; i++)
        good = good && s->volume_channels[i] >= 1 && s->volume_channels[i] <= 2048;
    good = good && s->position_frequencies >= 0 && s->position_frequencies <= 16 &&
           s->direction_frequencies >= 0 && s->direction_frequencies <= 16 && s->color_frequencies >= 0 &&
           s->color_frequencies <= 16;
    if (!good) return failure(c, SHERF_BAD_ARGUMENT, "point network: sizes out of range");
    if (3 * s->token_width - s->feature_channels > 3 * (1 + 2 * s->color_frequencies))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "point network: %d feature channels and the encoded color do not fill 3 tokens of %d",
                       s->feature_channels, s->token_width);
    return SHERF_OK;
}

static sherf_status pack(context *c, const point_matrix *m, int block, point_layer *out) {
    int rows = round_up(m->rows, block);
    *out = (point_layer){.rows = m->rows, .columns = m->columns, .block = block};
    out->w = mem_zero(c, (size_t)rows * (size_t)m->columns, sizeof(float));
    out->b = mem_zero(c, (size_t)rows, sizeof(float));
    if (!out->w || !out->b) return SHERF_NO_MEMORY;
    memcpy(out->b, m->b, (size_t)m->rows * sizeof(float));
    for (int r = 0; r < m->rows; r++)
        for (int k = 0; k < m->columns; k++)
            out->w[(size_t)(r / block * block) * (size_t)m->columns + (size_t)(k * block + r % block)] =
                m->w[(size_t)r * (size_t)m->columns + (size_t)k];
    return SHERF_OK;
}

static sherf_status pack_float(context *c, point_network *n, const point_matrices *m) {
    int block = n->isa >= ISA_AVX512 ? POINT_ROWS_AVX512
                : n->isa == ISA_AVX2 ? POINT_ROWS_AVX2
                                     : POINT_ROWS_PLAIN;
    sherf_status status = SHERF_OK;
    if (n->color_width) status = pack(c, &m->color, block, &n->color);
    if (!status) status = pack(c, &m->qkv, block, &n->qkv);
    if (!status) status = pack(c, &m->attention_out, block, &n->attention_out);
    if (!status) status = pack(c, &m->mlp0, block, &n->mlp0);
    if (!status) status = pack(c, &m->mlp1, block, &n->mlp1);
    if (!status) status = pack(c, &m->alpha, block, &n->alpha);
    if (!status) status = pack(c, &m->views, block, &n->views);
    if (!status) status = pack(c, &m->rgb, block, &n->rgb);
    for (int i = 0; i < n->s.decoder_depth && !status; i++) status = pack(c, &m->pts[i], block, &n->pts[i]);
    if (status) return status;
    n->tile = point_tile_plain;
#if defined(__x86_64__)
    if (n->isa == ISA_AVX2) n->tile = point_tile_avx2;
    if (n->isa >= ISA_AVX512) n->tile = point_tile_avx512;
#endif
    n->scratch_bytes = point_tile_float_bytes(n);
    return SHERF_OK;
}

static float *copy(context *c, const float *from, int count) {
    float *to = mem_alloc(c, (size_t)count, sizeof *to);
    if (to) memcpy(to, from, (size_t)count * sizeof *to);
    return to;
}

/* token_b: the projection's bias, and what the volume projection's bias becomes in it. */
static sherf_status copy_vectors(context *c, point_network *n, const point_weights *w) {
    int d = n->s.token_width;
    n->norm0_w = copy(c, w->norm0_w, d);
    n->norm0_b = copy(c, w->norm0_b, d);
    n->norm1_w = copy(c, w->norm1_w, d);
    n->norm1_b = copy(c, w->norm1_b, d);
    n->token_b = mem_alloc(c, (size_t)n->fused, sizeof(float));
    if (!n->norm0_w || !n->norm0_b || !n->norm1_w || !n->norm1_b || !n->token_b) return SHERF_NO_MEMORY;
    for (int row = 0; row < n->fused; row++) {
        double sum = w->token_projection_b[row % d];
        for (int j = 0; j < d; j++)
            sum += (double)w->token_projection_w[(size_t)(row % d) * n->fused + 2 * d + j] *
                   w->volume_projection_b[row / d * d + j];
        n->token_b[row] = (float)sum;
    }
    return SHERF_OK;
}

/* Its offsets are 32 bits. */
static bool amx_possible(const point_sizes *s, const point_bank *b) {
#if defined(__x86_64__)
    return isa_has_bf16() && (int64_t)b->feature_width * b->feature_height <= 10000000 &&
           (int64_t)b->image_width * b->image_height <= 100000000 && point_amx_fits(s);
#else
    return false;
#endif
}

sherf_status point_network_start(context *c, const point_sizes *sizes, const point_weights *weights,
                                 const point_bank *bank, bool bf16, point_matrices *m, point_network **out) {
    *out = NULL;
    sherf_status status = check_sizes(c, sizes);
    if (status) return status;
    point_network *n = mem_zero(c, 1, sizeof *n);
    if (!n) return SHERF_NO_MEMORY;
    n->s = *sizes;
    n->isa = isa_best();
    n->bf16 = bf16;
    n->fused = 3 * sizes->token_width;
    n->position_width = 3 * (1 + 2 * sizes->position_frequencies);
    n->direction_width = 3 * (1 + 2 * sizes->direction_frequencies);
    n->color_width = n->fused - sizes->feature_channels;
    n->color_token = sizes->feature_channels / sizes->token_width;
    n->map_tokens = (sizes->feature_channels + sizes->token_width - 1) / sizes->token_width;
    n->attention_width = sizes->heads * sizes->head_width;
    status = point_bank_prepare(c, n, weights, bank);
    if (!status) status = copy_vectors(c, n, weights);
    if (!status) status = point_matrices_make(c, n, weights, m);
    if (status)
        point_network_free(n);
    else
        *out = n;
    return status;
}

sherf_status point_network_create(context *c, const point_sizes *sizes, const point_weights *weights,
                                  const point_bank *bank, bool bf16, point_network **out) {
    point_matrices m = {0};
    point_network *n = NULL;
    *out = NULL;
    bf16 = bf16 && amx_possible(sizes, bank);
    if (bank->merged && !bf16)
        return failure(c, SHERF_UNSUPPORTED, "point network: a merged bank is for bf16 only");
    sherf_status status = point_network_start(c, sizes, weights, bank, bf16, &m, &n);
#if defined(__x86_64__)
    if (!status && n->bf16) status = point_amx_create(c, n, &m);
#endif
    if (!status && !n->bf16) status = pack_float(c, n, &m);
    point_matrices_free(&m);
    if (status)
        point_network_free(n);
    else
        *out = n;
    return status;
}

static void layer_free(point_layer *l) {
    mem_free(l->w);
    mem_free(l->b);
}

void point_network_free(point_network *n) {
    if (!n) return;
    point_layer *layers[] = {&n->color, &n->qkv,   &n->attention_out, &n->mlp0,
                             &n->mlp1,  &n->alpha, &n->views,         &n->rgb};
    for (size_t i = 0; i < COUNT_OF(layers); i++) layer_free(layers[i]);
    for (int i = 0; i < POINT_DECODER_MAX; i++) layer_free(&n->pts[i]);
    for (int i = 0; i < 3; i++) {
        mem_free(n->plane[i].texel);
        mem_free(n->plane[i].half);
    }
    mem_free(n->map.texel);
    mem_free(n->map.half);
    mem_free(n->image);
    for (int i = 0; i < POINT_LEVELS; i++) {
        mem_free(n->level[i].cell);
        mem_free(n->level[i].corner);
        mem_free(n->level[i].value);
        mem_free(n->level[i].half);
    }
#if defined(__x86_64__)
    point_amx_free(n->amx);
#endif
    mem_free(n->norm0_w);
    mem_free(n->norm0_b);
    mem_free(n->norm1_w);
    mem_free(n->norm1_b);
    mem_free(n->token_b);
    mem_free(n);
}

/* ---- points through the network ---- */
bool point_network_in_bf16(const point_network *n) {
    return n->bf16;
}

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
    const point_network *n;
    const point_set *points;
    char *scratch; /* one part a thread */
    size_t part;
    atomic_llong next; /* the next piece of work that nobody has */
    int64_t pieces;
    float *rgb, *sigma;
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
        w->n->tile(w->n, &t, scratch);
        for (int p = 0; p < t.count; p++) {
            for (int k = 0; k < 3; k++) w->rgb[3 * (first + p) + k] = t.out[k][p];
            w->sigma[first + p] = t.out[3][p];
        }
    }
}

static sherf_status start_work(context *c, const point_network *n, const point_set *points, size_t extra,
                               work *w) {
    if (points->count && (!points->observed_px || !points->direction_canonical))
        return failure(c, SHERF_BAD_ARGUMENT, "point network: the points lack directions or observed pixels");
    w->c = c;
    w->n = n;
    w->points = points;
    w->part = (n->scratch_bytes + extra + 4095) / 4096 * 4096;
    w->scratch = mem_alloc(c, (size_t)c->threads, w->part);
    return w->scratch ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status do_work(work *w, range_function f) {
    parallel_for(w->c, w->c->threads, 1, f, w);
    mem_free(w->scratch);
    return cancelled(w->c) ? failure(w->c, SHERF_CANCELLED, "cancelled") : SHERF_OK;
}

sherf_status point_network_run(context *c, const point_network *n, const point_set *points, float *rgb,
                               float *sigma) {
    work w = {.rgb = rgb, .sigma = sigma, .pieces = (points->count + POINT_TILE - 1) / POINT_TILE};
    sherf_status status = start_work(c, n, points, 0, &w);
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

static void flush(const work *w, block_space *b, void *scratch) {
    if (!b->tile.count) return;
    point_tile_fill(w->points, b->index, 0, b->tile.count, &b->tile);
    w->n->tile(w->n, &b->tile, scratch);
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

/* As write_ray for a ray without points, whose direction and range need not be read. */
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

/* Takes the points in the order ray by ray; with early_stop in rounds of CHUNK a ray, so that rays that have
 * become opaque drop out: what a round leaves of a tile waits for the next one. Points of a ray stay in
 * order, whichever tile they fall into. */
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

sherf_status point_network_render(context *c, const point_network *n, const ray_bundle *rays,
                                  const point_set *points, const float background[3], bool early_stop,
                                  sherf_frame *frame) {
    int64_t count = (int64_t)rays->width * rays->height;
    if (points->rays != count || points->samples < 1)
        return failure(c, SHERF_BAD_ARGUMENT, "point network: points of %lld rays for a picture of %lld",
                       (long long)points->rays, (long long)count);
    work w = {.rays = rays, .background = background, .early_stop = early_stop && n->bf16, .frame = frame};
    w.depth_min = INFINITY;
    w.depth_max = -INFINITY;
    for (int64_t i = 0; i < count; i++) {
        float near = rays->near[i], far = rays->far[i], low = near < far ? near : far;
        w.depth_min = low < w.depth_min ? low : w.depth_min;
        float high = near < far ? far : near;
        w.depth_max = high > w.depth_max ? high : w.depth_max;
    }
    w.pieces = (int64_t)((rays->width + BLOCK_SIDE - 1) / BLOCK_SIDE) *
               ((rays->height + BLOCK_SIDE - 1) / BLOCK_SIDE);
    sherf_status status = frame_shape(c, rays->width, rays->height, frame);
    if (!status) status = start_work(c, n, points, sizeof(block_space) + 64, &w);
    if (status) return status;
    frame->points = points->count;
    return do_work(&w, run_blocks);
}
