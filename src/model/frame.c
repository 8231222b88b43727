/* A model on a tape: encode, then the points in chunks that are computed again in the backward pass. */
#include <math.h>

#include "model/model.h"

enum { CHUNK_POINTS = 8192 };

tape *tape_for_parts(tape *t) {
    return tape_records(t) ? t : tape_nested(t, false);
}

tensor *tape_keep(tape *t, tape *work, tensor *x) {
    if (work == t) return x;
    tensor *copy = NULL;
    if (!x)
        tape_fail(t, tape_status(work), "%s", tape_context(t)->message);
    else if ((copy = tape_tensor(t, x->type, x->rank, x->dim))) {
        sherf_status status = tensor_copy_rows(tape_context(t), copy, 0, x, 0, tensor_rows(x));
        if (status != SHERF_OK) copy = tape_fail(t, status, "%s", tape_context(t)->message);
    }
    tape_reset(work);
    return copy;
}

sherf_status model_encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank) {
    *bank = (model_bank){0};
    return m->config.kind->encode(t, m, body, g, bank);
}

/* What the backward pass needs to run a chunk again. */
typedef struct {
    const model *m;
    const body_model *body;
    const observation_geometry *g;
    const point_set *points;
    model_bank bank;
    tensor *sigma, *rgb;
} points_node;

sherf_status model_query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                         const model_bank *bank, const point_set *points, tensor *sigma, tensor *rgb) {
    tape *inner = tape_nested(t, false);
    if (!inner) return tape_status(t);
    for (int64_t begin = 0; begin < points->count; begin += CHUNK_POINTS) {
        int64_t end = begin + CHUNK_POINTS < points->count ? begin + CHUNK_POINTS : points->count;
        tensor *part[2] = {NULL, NULL};
        if (cancelled(tape_context(t))) return failure(tape_context(t), SHERF_CANCELLED, "cancelled");
        tape_reset(inner);
        sherf_status status =
            m->config.kind->query(inner, m, body, g, bank, points, begin, end, &part[0], &part[1]);
        if (status != SHERF_OK) return status;
        status = tensor_copy_rows(tape_context(t), sigma, begin, part[0], 0, end - begin);
        if (status == SHERF_OK)
            status = tensor_copy_rows(tape_context(t), rgb, begin, part[1], 0, end - begin);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

static sherf_status seed(tape *inner, tensor *x, const tensor *from, int64_t begin) {
    if (!from) return SHERF_OK;
    tensor *grad = tape_grad(inner, x);
    if (!grad) return tape_status(inner);
    return tensor_copy_rows(tape_context(inner), grad, 0, from, begin, tensor_rows(x));
}

/* The backward pass: from d sigma and d rgb to the gradients of the bank and the weights, chunk by chunk. */
static sherf_status points_backward(tape *t, void *payload) {
    points_node *n = payload;
    if (!n->sigma->grad && !n->rgb->grad) return SHERF_OK;
    for (int i = 0; i < n->bank.count; i++) { /* allocated here, so that they outlive the inner tape */
        tensor *outer = n->bank.tensor[i];
        if (outer->needs_grad && !tape_grad(t, outer)) return tape_status(t);
    }
    tape *inner = tape_nested(t, true);
    if (!inner) return tape_status(t);
    for (int64_t begin = 0; begin < n->points->count; begin += CHUNK_POINTS) {
        int64_t end = begin + CHUNK_POINTS < n->points->count ? begin + CHUNK_POINTS : n->points->count;
        tensor *sigma, *rgb;
        if (cancelled(tape_context(t))) return failure(tape_context(t), SHERF_CANCELLED, "cancelled");
        tape_reset(inner);
        sherf_status status = n->m->config.kind->query(inner, n->m, n->body, n->g, &n->bank, n->points, begin,
                                                       end, &sigma, &rgb);
        if (status == SHERF_OK) status = seed(inner, sigma, n->sigma->grad, begin);
        if (status == SHERF_OK) status = seed(inner, rgb, n->rgb->grad, begin);
        if (status == SHERF_OK) status = tape_backward_seeded(inner);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* Standard normal noise on the raw density, keyed by the sample's place in the frame so that it does not
 * depend on which points were kept. */
typedef struct {
    const point_set *points;
    uint64_t key;
    float *noise;
} noise_job;

static void noise_range(void *arg, int64_t begin, int64_t end, int thread) {
    const noise_job *j = arg;
    const point_set *p = j->points;
    for (int64_t i = begin; i < end; i++)
        j->noise[i] =
            (float)random_normal(j->key, (uint64_t)p->ray[i] * (uint64_t)p->samples + (uint64_t)p->sample[i]);
}

static tensor *noise_add(tape *t, tensor *sigma, const point_set *points, uint64_t key) {
    if (!key || !sigma) return sigma;
    float *noise = tape_alloc(t, (size_t)points->count, sizeof *noise);
    if (!noise) return NULL;
    noise_job job = {points, key, noise};
    parallel_for(tape_context(t), points->count, 4096, noise_range, &job);
    return op_add(t, sigma, tape_input(t, noise, 2, (int64_t[]){points->count, 1}));
}

/* [P, 2]: depth of each point, and the distance to the next one or to the end of the box. */
static tensor *own_depths(tape *t, const target_geometry *g, const point_set *p) {
    float *at = tape_alloc(t, (size_t)p->count, 2 * sizeof *at);
    if (!at) return NULL;
    for (int64_t n = 0; n < p->rays; n++)
        for (int64_t i = p->first[n]; i < p->first[n + 1]; i++) {
            at[2 * i] = p->depth[i];
            at[2 * i + 1] = (i + 1 < p->first[n + 1] ? p->depth[i + 1] : g->rays->far[n]) - p->depth[i];
            if (i + 1 == p->first[n + 1] && p->last_way > 0) at[2 * i + 1] = p->last_way;
        }
    return tape_input(t, at, 2, (int64_t[]){p->count, 2});
}

static tensor *composite_frame(tape *t, const target_geometry *g, const point_set *p, tensor *sigma,
                               tensor *rgb, float background) {
    int64_t N = p->rays, first = p->rays + 1;
    tensor *at = NULL;
    float *length = tape_alloc(t, (size_t)N, sizeof *length);
    if (!length) return NULL;
    for (int64_t i = 0; i < N; i++) {
        const float *d = g->rays->direction + 3 * i;
        length[i] = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    }
    if (p->depth && !(at = own_depths(t, g, p))) return NULL;
    composite_attr attr = {p->samples, background, g->depth_min, g->depth_max};
    return op_composite(t, sigma, rgb, tape_input_i32(t, p->first, 1, &first),
                        tape_input_i32(t, p->sample, 1, &p->count), tape_input(t, g->rays->near, 1, &N),
                        tape_input(t, g->rays->far, 1, &N), tape_input(t, length, 1, &N), at, attr);
}

sherf_status model_pass(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                        model_bank *bank, const target_geometry *target, const point_set *points,
                        float background, uint64_t noise_key, tensor **sigma, tensor **frame) {
    *frame = NULL;
    if (tape_status(t) != SHERF_OK) return tape_status(t);
    int64_t P = points->count;
    dtype real = tape_backend(t)->real;
    points_node *n = tape_alloc(t, 1, sizeof *n);
    if (!n) return tape_status(t);
    *n = (points_node){m, body, g, points, *bank, NULL, NULL};
    n->sigma = tape_tensor(t, real, 2, (int64_t[]){P, 1});
    n->rgb = tape_tensor(t, real, 2, (int64_t[]){P, 3});
    if (!n->sigma || !n->rgb) return tape_status(t);
    sherf_status status;
    const model_fused_training *fused = m->config.kind->fused_training;
    if (fused && fused->possible(t, m)) {
        status = fused->run(t, m, body, g, bank, points, n->sigma, n->rgb);
        if (status != SHERF_OK) return status;
    } else {
        status = model_query(t, m, body, g, &n->bank, n->points, n->sigma, n->rgb);
        if (status != SHERF_OK) return status;
        if (tape_records(t)) tape_record(t, points_backward, n);
    }
    n->sigma->needs_grad = n->rgb->needs_grad = tape_records(t);
    if (sigma) *sigma = n->sigma;
    *frame =
        composite_frame(t, target, points, noise_add(t, n->sigma, points, noise_key), n->rgb, background);
    return tape_status(t);
}

sherf_status model_frame(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                         model_bank *bank, const target_geometry *target, float background,
                         uint64_t noise_key, tensor **frame) {
    *frame = NULL;
    bank->coarse = NULL;
    if (m->config.kind->frame)
        return m->config.kind->frame(t, m, body, g, bank, target, background, noise_key, frame);
    return model_pass(t, m, body, g, bank, target, target->points, background, noise_key, NULL, frame);
}
