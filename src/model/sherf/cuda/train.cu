/* The fused radiance field in training: the parts that are made once for each observation, and a frame's
 * forward and backward pass. */
#include "model/sherf/cuda/train.h"

struct gpu_points {
    cuda_backend::train_network n;
};

namespace cuda_backend {

static network_sizes sizes_of(const radiance_sizes *s) {
    const int D = s->token_width, fused = 3 * D, color = fused - s->feature_channels;
    return {D,
            fused,
            s->heads,
            s->head_width,
            s->heads * s->head_width,
            color,
            D > 0 ? s->feature_channels / D : 0,
            s->color_frequencies,
            3 * (1 + 2 * s->position_frequencies),
            s->position_frequencies,
            3 * (1 + 2 * s->direction_frequencies),
            s->direction_frequencies,
            s->decoder_width,
            s->decoder_depth,
            s->decoder_skip,
            s->view_width};
}

static bool possible(const radiance_sizes *s) {
    return bf16_fits(sizes_of(s)) && s->feature_channels % TOKEN == 0 && s->feature_channels <= TOKENS &&
           s->decoder_depth >= 2 && s->decoder_depth <= POINT_DECODER_MAX;
}

static sherf_status create(tape *t, const radiance_sizes *sizes, const radiance_weights *weights,
                           const radiance_bank *bank, gpu_points **out) {
    context *c = tape_context(t);
    *out = nullptr;
    if (!possible(sizes))
        return failure(c, SHERF_UNSUPPORTED, "radiance field: no fused training for these sizes on a GPU");
    gpu_points *p = (gpu_points *)tape_alloc(t, 1, sizeof *p);
    if (!p) return tape_status(t);
    train_network *n = &p->n;
    *n = {};
    n->s = sizes_of(sizes);
    n->h_tiles = h_tiles_of(sizes->decoder_width);
    n->feature_channels = sizes->feature_channels;
    n->w = *weights;
    train_bank_of(sizes, bank, &n->bank);
    train_sums_plan(n->s, n->h_tiles, &n->at, &n->sums);
    n->units = train_units(n->s, n->h_tiles, n->at, n->sums, nullptr);
    sums_unit *unit = (sums_unit *)tape_alloc(t, (size_t)n->units, sizeof *unit);
    const int64_t bytes = (int64_t)n->units * (int64_t)sizeof *unit;
    const tensor *there = tape_tensor(t, T_U8, 1, &bytes);
    if (!unit || !there) return tape_status(t);
    train_units(n->s, n->h_tiles, n->at, n->sums, unit);
    n->unit = (const sums_unit *)there->data;
    sherf_status status = device_memory.upload(c, there->data, unit, (size_t)bytes);
    if (!status) status = train_pack(t, n);
    if (!status) *out = p;
    return status;
}

/* Allocates a chunk's memory, for as many of `points` as are processed at a time. */
static sherf_status chunk_room(context *c, arena *a, const train_network *n, int64_t points, bool back,
                               train_run *r) {
    const int64_t some = points < train_at_a_time ? points : train_at_a_time;
    const int64_t max = divided_up(some, BLOCK_POINTS) * BLOCK_POINTS; /* includes all rows of a tile */
    *r = {};
    r->s = n->s;
    r->layers = n->layers;
    r->back_stages = n->back_stages;
    r->back = n->back;
    r->at = n->at;
    r->tokens = room<float>(c, a, max * TOKENS);
    r->color = room<float>(c, a, max * 3);
    if (!r->tokens || !r->color) return SHERF_NO_MEMORY;
    if (!back) return SHERF_OK;
    r->records = room<uint4>(c, a, max / TILE_POINTS * n->at.tiles * WARP);
    r->dfused = room<float>(c, a, max * 2 * TOKEN);
    r->dtokens = room<float>(c, a, points * TOKENS);
    r->vectors = room<float>(c, a, (int64_t)FUSION_BLOCKS * VECTOR_SLOTS * THREADS);
    return r->records && r->dfused && r->dtokens && r->vectors ? SHERF_OK : SHERF_NO_MEMORY;
}

static void chunk_points_of(const gpu_point_set *points, const int32_t *list, const int32_t *count,
                            train_run *r) {
    r->canonical = points->canonical;
    r->direction = points->direction_canonical;
    r->observed_px = points->observed_px;
    r->list = list;
    r->count = count;
}

static void chunk_at(int64_t base, int64_t points, train_run *r) {
    r->base = base;
    r->max = points - base < train_at_a_time ? points - base : train_at_a_time;
}

static sherf_status run_in(context *c, arena *a, const train_network *n, const gpu_point_set *points,
                           float *rgb, float *sigma) {
    train_run r;
    const int64_t P = points->count;
    int32_t *list = room<int32_t>(c, a, P + 1);
    sherf_status status = list ? chunk_room(c, a, n, P, false, &r) : SHERF_NO_MEMORY;
    if (status) return status;
    each(P + 1, [=] __device__(int64_t i) { list[i] = (int32_t)i; });
    chunk_points_of(points, list, list + P, &r);
    r.rgb = rgb;
    r.sigma = sigma;
    for (int64_t base = 0; base < P; base += train_at_a_time) {
        chunk_at(base, P, &r);
        train_sample(n, r);
        train_decode(n, r, false);
    }
    return finished_work(c, "the radiance field");
}

/* Lists the points that have a gradient: the list, and their number in first[P]. */
static sherf_status list_points(context *c, arena *a, int64_t P, const float *drgb, const float *dsigma,
                                int32_t *list, int32_t *first) {
    int32_t *sums = room<int32_t>(c, a, scan_sums(P));
    if (!sums) return SHERF_NO_MEMORY;
    each(P, [=] __device__(int64_t i) {
        const float *d = drgb + 3 * i;
        first[i] = d[0] != 0 || d[1] != 0 || d[2] != 0 || dsigma[i] != 0;
    });
    scan(P, nullptr, first, sums);
    each(P, [=] __device__(int64_t i) {
        if (first[i + 1] > first[i]) list[first[i]] = (int32_t)i;
    });
    return SHERF_OK;
}

static sherf_status backward_in(context *c, arena *a, const train_network *n, const gpu_point_set *points,
                                const float *rgb, const float *drgb, const float *dsigma,
                                const radiance_gradients *out) {
    train_run r;
    const int64_t P = points->count, floats = n->sums.floats;
    int32_t *list = room<int32_t>(c, a, P), *first = room<int32_t>(c, a, P + 1);
    float *partial = room<float>(c, a, SLABS * floats), *total = room<float>(c, a, floats);
    float *vector = room<float>(c, a, VECTORS * TOKEN);
    if (!list || !first || !partial || !total || !vector) return SHERF_NO_MEMORY;
    sherf_status status = list_points(c, a, P, drgb, dsigma, list, first);
    if (!status) status = chunk_room(c, a, n, P, true, &r);
    if (!status) status = device_memory.clear(c, partial, (size_t)(SLABS * floats) * sizeof *partial);
    if (!status)
        status =
            device_memory.clear(c, r.vectors, (size_t)FUSION_BLOCKS * VECTOR_SLOTS * THREADS * sizeof(float));
    if (status) return status;
    chunk_points_of(points, list, first + P, &r);
    r.rgb = (float *)rgb;
    r.drgb = drgb;
    r.dsigma = dsigma;
    for (int64_t base = 0; base < P; base += train_at_a_time) {
        chunk_at(base, P, &r);
        train_sample(n, r);
        train_decode(n, r, true);
        train_fusion(r);
        train_weights(n, r, partial);
    }
    train_unpack(n, partial, r.vectors, total, vector, out);
    status = train_scatter(c, a, n, r, P, out);
    return status ? status : finished_work(c, "the radiance field's gradients");
}

static sherf_status too_many(context *c, const train_network *n, int64_t count) {
    bool rows = false;
    for (const train_part &p : n->bank.part) rows = rows || p.rows >= INT32_MAX;
    if (count <= INT32_MAX / 8 && !rows) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "radiance field: %lld points are too many", (long long)count);
}

static sherf_status run(tape *t, const gpu_points *p, const gpu_point_set *points, float *rgb, float *sigma) {
    arena *a = tape_scratch(t);
    const arena_mark mark = arena_position(a);
    sherf_status status = too_many(tape_context(t), &p->n, points->count);
    if (!status && points->count) status = run_in(tape_context(t), a, &p->n, points, rgb, sigma);
    arena_rewind(a, mark); /* in the stream's order */
    return status;
}

static sherf_status backward(tape *t, const gpu_points *p, const gpu_point_set *points, const float *rgb,
                             const float *drgb, const float *dsigma, const radiance_gradients *out) {
    arena *a = tape_scratch(t);
    const arena_mark mark = arena_position(a);
    sherf_status status = too_many(tape_context(t), &p->n, points->count);
    if (!status && points->count)
        status = backward_in(tape_context(t), a, &p->n, points, rgb, drgb, dsigma, out);
    arena_rewind(a, mark);
    return status;
}

const gpu_point_training points_training = {possible, create, run, backward};

} // namespace cuda_backend
