/* How near the parts of the work come to the processor's peak: counts multiply-adds from the shapes passed to
 * a backend and times its kernels. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "train/bench.h"

/* ---- the peak ---- */
float bench_peak_plain(int64_t rounds);
float bench_peak_neon(int64_t rounds);
float bench_peak_avx2(int64_t rounds);
float bench_peak_avx512(int64_t rounds);

typedef struct {
    float (*run)(int64_t rounds);
    float *sum; /* a thread's */
} peak_job;
enum { PEAK_ROUNDS = 400000, PEAK_RUNS = 5, PEAK_THREADS_MAX = 1024 };

static void peak_range(void *arg, int64_t begin, int64_t end, int thread) {
    const peak_job *j = arg;
    for (int64_t i = begin; i < end; i++) j->sum[i] = j->run(PEAK_ROUNDS);
}

double bench_fma_gflops(const context *c) {
    static float sum[PEAK_THREADS_MAX];
    static double known;
    if (known > 0) return known;
    const isa_level isa = isa_best();
    const int lanes = isa >= ISA_AVX512 ? 16 : isa >= ISA_AVX2 ? 8 : 4;
    const int chains = isa == ISA_NEON ? 24 : 12; /* bench_peak.h */
    const int threads = c->threads < PEAK_THREADS_MAX ? c->threads : PEAK_THREADS_MAX;
    peak_job job = {ISA_CHOICE(isa, bench_peak), sum};
    double best = 0;
    for (int i = 0; i < PEAK_RUNS; i++) {
        const double from = time_seconds();
        parallel_for(c, threads, 1, peak_range, &job);
        const double flops = 2.0 * PEAK_ROUNDS * chains * lanes * threads;
        best = fmax(best, 1e-9 * flops / (time_seconds() - from));
    }
    return known = best;
}

/* ---- ops, counted ---- */
/* One bench runs at a time, and a backend's kernels know nobody else: hence the statics. */
static struct {
    const backend *of;
    backend as;
    double products[SHARES], seconds[SHARES];
} counted;

static int share_of(op_id op) {
    return op == OP_conv2d || op == OP_conv2d_transpose ? SHARE_CONVOLUTIONS
           : op == OP_sparse_conv                       ? SHARE_SPARSE
                                                        : SHARE_LINEAR;
}

/* Multiply-adds of a pass forwards. */
static double products_of(const op_call *call) {
    const tensor *x = call->in[0], *w = call->in[1], *y = call->out[0];
    const double taps = call->op == OP_linear ? 1 : (double)(w->dim[2] * w->dim[3]);
    if (call->op == OP_conv2d_transpose) return (double)tensor_count(x) * (double)w->dim[0] * taps;
    if (call->op != OP_sparse_conv) return (double)tensor_count(y) * (double)tensor_columns(x) * taps;
    double pairs = 0;
    const tensor *rule = call->in[2];
    for (int64_t i = 0; i < tensor_count(rule); i++) pairs += tensor_i32(rule)[i] >= 0;
    return pairs * (double)tensor_columns(x) * (double)tensor_columns(y);
}

static sherf_status count(op_call *call, kernel run, int passes) {
    const int share = share_of(call->op);
    const double from = time_seconds();
    const sherf_status status = run(call);
    counted.seconds[share] += time_seconds() - from;
    counted.products[share] += passes * products_of(call);
    return status;
}

static sherf_status forward_counted(op_call *call) {
    return count(call, counted.of->forward[call->op], 1);
}

static sherf_status backward_counted(op_call *call) {
    return count(call, counted.of->backward[call->op], (call->din[0] != NULL) + (call->din[1] != NULL));
}

static const backend *counting(const backend *of) {
    static const op_id ops[] = {OP_conv2d, OP_conv2d_transpose, OP_sparse_conv, OP_linear};
    memset(&counted, 0, sizeof counted);
    counted.of = of;
    counted.as = *of;
    for (size_t i = 0; i < COUNT_OF(ops); i++) {
        counted.as.forward[ops[i]] = forward_counted;
        counted.as.backward[ops[i]] = backward_counted;
    }
    return &counted.as;
}

/* An encoding, and back from gradients of zero. */
static sherf_status encode_once(bench *b, tape *t, const observation_geometry *g) {
    model_bank bank;
    tape_reset(t);
    sherf_status status = model_encode(t, b->model, b->body, g, &bank);
    if (status != SHERF_OK || !tape_records(t)) return status;
    for (int i = 0; i < bank.count; i++)
        if (bank.tensor[i] && bank.tensor[i]->needs_grad && !tape_grad(t, bank.tensor[i]))
            return tape_status(t);
    return tape_backward_seeded(t);
}

sherf_status bench_encode_shares(bench *b, bool training, bench_shares *out) {
    context *c = b->c;
    const sherf_observation *o = b->observation;
    const backend *on = backend_of(c);
    observation_geometry *g = NULL;
    if (on->memory) return SHERF_OK; /* a GPU's kernels run asynchronously */
    tape *t = tape_create(c, (tape_options){.backend = counting(on),
                                            .record = training,
                                            .training = training,
                                            .bf16 = c->precision == SHERF_PRECISION_BF16});
    if (!t) return SHERF_NO_MEMORY;
    sherf_status status = observation_geometry_create(c, &b->model->config, b->body, &o->image, &o->camera,
                                                      &o->pose, training, &g);
    if (status == SHERF_OK) status = encode_once(b, t, g); /* plans and pages */
    memset(counted.products, 0, sizeof counted.products);
    memset(counted.seconds, 0, sizeof counted.seconds);
    if (status == SHERF_OK) status = encode_once(b, t, g);
    for (int i = 0; i < SHARES && status == SHERF_OK; i++)
        if (counted.seconds[i] > 0) out->gflops[i] = 2e-9 * counted.products[i] / counted.seconds[i];
    tape_free(t);
    observation_geometry_free(g);
    return status;
}

/* ---- the point network ---- */
typedef struct {
    const sherf_avatar *a;
    const point_set *points;
    float *rgb, *sigma;
} network_job;

static sherf_status network_once(bench *b, void *arg) {
    const network_job *j = arg;
    return avatar_query(b->c, j->a, b->body, j->points, j->rgb, j->sigma);
}

sherf_status bench_network_share(bench *b, const sherf_avatar *a, bench_shares *out) {
    context *c = b->c;
    const model_config *config = &b->model->config;
    const sherf_observation *o = b->observation, *target = b->target;
    observation_geometry *g = NULL;
    target_geometry *at = NULL;
    network_job job = {.a = a};
    double ms = 0;
    if (!config->kind->point_products) return SHERF_OK;
    sherf_status status =
        observation_geometry_create(c, config, b->body, &o->image, &o->camera, &o->pose, false, &g);
    if (status == SHERF_OK)
        status = target_geometry_create(c, config, b->body, &target->camera, &target->pose, g, false, &at);
    if (status != SHERF_OK) goto done;
    job.points = at->points;
    job.rgb = mem_alloc(c, (size_t)at->points->count, 3 * sizeof(float));
    job.sigma = mem_alloc(c, (size_t)at->points->count, sizeof(float));
    status = job.rgb && job.sigma ? bench_timed(b, network_once, &job, &ms) : SHERF_NO_MEMORY;
    if (status == SHERF_OK && ms > 0)
        out->gflops[SHARE_NETWORK] =
            2e-6 * config->kind->point_products(config) * (double)at->points->count / ms;
done:
    mem_free(job.rgb);
    mem_free(job.sigma);
    target_geometry_free(at);
    observation_geometry_free(g);
    return status;
}

/* ---- the report ---- */
static const char *const share_name[SHARES] = {"convolutions", "sparse_convolutions", "linear", "network"};

char *bench_shares_json(context *c, const bench_shares *s) {
    const double peak = bench_fma_gflops(c);
    char text[256] = "";
    size_t n = 0;
    for (int i = 0; i < SHARES; i++)
        if (s->gflops[i] > 0)
            n += (size_t)snprintf(text + n, sizeof text - n, "%s\"%s\": %.3f", n ? ", " : "", share_name[i],
                                  s->gflops[i] / peak);
    return mem_format(c, "\"fma_gflops\": %.1f, \"share_of_peak\": {%s}", peak, text);
}

char *bench_shares_text(context *c, const bench_shares *s) {
    const double peak = bench_fma_gflops(c);
    char text[256] = "";
    size_t n = 0;
    for (int i = 0; i < SHARES; i++)
        if (s->gflops[i] > 0)
            n += (size_t)snprintf(text + n, sizeof text - n, "; %s %.0f %%", share_name[i],
                                  100 * s->gflops[i] / peak);
    return mem_format(c, "float32 multiply-adds reach %.0f GFLOP/s; of that%s\n", peak,
                      *text ? text + 1 : " -");
}
