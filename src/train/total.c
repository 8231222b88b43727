/* Gradients of a step: the sum over its samples, in a fixed order. */
#include <math.h>
#include <string.h>

#include "tensor/block.h"
#include "train/trainer.h"

void total_free(step_total *s) {
    const tensor_memory *memory = s->weights ? s->weights->memory : NULL;
    for (int i = 0; s->branch && i < s->levels; i++) block_give(memory, s->branch[i]);
    mem_free(s->branch);
    mem_free(s->full);
    block_give(memory, s->before);
    block_give(memory, s->statistics);
    block_give(memory, s->rows);
    mem_free(s->losses);
    buckets_free(s->buckets);
    *s = (step_total){0};
}

sherf_status total_create(context *c, parameters *weights, int samples, int begin, int end, int targets,
                          step_total *out) {
    const tensor_memory *memory = weights->memory;
    *out = (step_total){
        .weights = weights, .samples = samples, .begin = begin, .end = end, .targets = targets, .levels = 1};
    while ((end - begin) >> out->levels) out->levels++;
    out->buffers = weights->total_floats - weights->trained_floats;
    const size_t buffers = (size_t)out->buffers, row = (size_t)targets * LOSSES;
    out->branch = mem_zero(c, (size_t)out->levels, sizeof *out->branch);
    out->full = mem_zero(c, (size_t)out->levels, sizeof *out->full);
    out->before = block_take(c, memory, buffers, sizeof *out->before);
    out->statistics = block_take(c, memory, (size_t)samples, buffers * sizeof *out->statistics);
    out->rows = block_take(c, memory, (size_t)(end - begin), row * sizeof *out->rows);
    out->losses = mem_zero(c, (size_t)samples, LOSSES * sizeof *out->losses);
    if (out->branch && out->full && out->before && out->statistics && out->rows && out->losses)
        return SHERF_OK;
    total_free(out);
    return SHERF_NO_MEMORY;
}

static float *buffers(const step_total *s) {
    return s->weights->values + s->weights->trained_floats;
}

static size_t buffer_bytes(const step_total *s) {
    return (size_t)s->buffers * sizeof(float);
}

/* Losses of no target: not a number. */
static sherf_status rows_empty(context *c, step_total *s) {
    enum { PART = 256 };
    float none[PART];
    const size_t n = (size_t)(s->end - s->begin) * (size_t)s->targets * LOSSES;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < PART; i++) none[i] = NAN;
    for (size_t i = 0; i < n && status == SHERF_OK; i += PART) {
        const size_t part = n - i < PART ? n - i : PART;
        status = block_upload(c, s->weights->memory, s->rows + i, none, part * sizeof *none);
    }
    return status;
}

sherf_status total_start(context *c, step_total *s) {
    const tensor_memory *memory = s->weights->memory;
    parameters_zero_grads(s->weights);
    if (s->buckets) buckets_begin(s->buckets);
    memset(s->full, 0, (size_t)s->levels * sizeof *s->full);
    memset(s->losses, 0, (size_t)s->samples * LOSSES * sizeof *s->losses);
    sherf_status status = block_copy(c, memory, s->before, buffers(s), buffer_bytes(s));
    if (status == SHERF_OK)
        status = block_clear(c, memory, s->statistics, (size_t)s->samples * buffer_bytes(s));
    return status == SHERF_OK ? rows_empty(c, s) : status;
}

sherf_status total_undo(context *c, step_total *s) {
    return block_copy(c, s->weights->memory, buffers(s), s->before, buffer_bytes(s));
}

float *total_rows(const step_total *s, int number) {
    return s->rows + (size_t)(number - s->begin) * (size_t)s->targets * LOSSES;
}

/* ---- gradients ---- */
typedef struct {
    float *to;
    const float *from;
    bool add;
} move_job;

static void move_range(void *arg, int64_t begin, int64_t end, int thread) {
    const move_job *j = arg;
    float *restrict to = j->to;
    const float *restrict from = j->from;
    if (!j->add)
        memcpy(to + begin, from + begin, (size_t)(end - begin) * sizeof(float));
    else
        for (int64_t i = begin; i < end; i++) to[i] += from[i];
}

static sherf_status move(context *c, const step_total *s, int64_t n, float *to, const float *from, bool add) {
    const tensor_memory *memory = s->weights->memory;
    if (memory && add) return memory->blocks->add(c, n, to, from);
    if (memory) return memory->copy(c, to, from, (size_t)n * sizeof *to);
    move_job job = {to, from, add};
    parallel_for(c, n, 1 << 14, move_range, &job);
    return SHERF_OK;
}

/* Into the gradients: every finished branch below *level, smallest first. */
static sherf_status gather(context *c, step_total *s, int *level) {
    sherf_status status = SHERF_OK;
    for (*level = 0; *level < s->levels && s->full[*level] && status == SHERF_OK; ++*level) {
        status = move(c, s, s->weights->trained_floats, s->weights->grads, s->branch[*level], true);
        s->full[*level] = false;
    }
    return status;
}

sherf_status total_add(context *c, step_total *s, int number) {
    const tensor_memory *memory = s->weights->memory;
    float *row = s->statistics + (size_t)number * (size_t)s->buffers;
    int level;
    sherf_status status = block_copy(c, memory, row, buffers(s), buffer_bytes(s));
    if (status != SHERF_OK || number + 1 == s->end) return status; /* the last one stays where it is */
    if ((status = total_undo(c, s)) != SHERF_OK) return status;
    if ((status = gather(c, s, &level)) != SHERF_OK) return status;
    if (!s->branch[level]) {
        s->branch[level] = block_take(c, memory, (size_t)s->weights->trained_floats, sizeof(float));
        if (!s->branch[level]) return SHERF_NO_MEMORY;
    }
    status = move(c, s, s->weights->trained_floats, s->branch[level], s->weights->grads, false);
    s->full[level] = true;
    parameters_zero_grads(s->weights);
    return status;
}

/* The last sample's gradients are in a stretch of the block: the branches' come on top, smallest first. */
static sherf_status branches_add(context *c, void *total, int64_t begin, int64_t n) {
    const step_total *s = total;
    sherf_status status = SHERF_OK;
    for (int level = 0; level < s->levels && status == SHERF_OK; level++)
        if (s->full[level]) status = move(c, s, n, s->weights->grads + begin, s->branch[level] + begin, true);
    return status;
}

sherf_status total_overlap(context *c, step_total *s, const ranks *r) {
    if (!r->group) return SHERF_OK;
    return buckets_create(c, s->weights, r, branches_add, s, &s->buckets);
}

void total_watch(step_total *s, tape *t, int number) {
    const bool last = s->buckets && number + 1 == s->end;
    tape_on_final(t, last ? buckets_final : NULL, s->buckets);
}

/* Over this process's samples, and over the processes. */
static sherf_status sum_gradients(context *c, step_total *s, const ranks *r) {
    const parameters *p = s->weights;
    if (s->buckets) return buckets_finish(c, s->buckets);
    sherf_status status = branches_add(c, s, 0, p->trained_floats);
    return status == SHERF_OK ? ranks_sum(c, r, p->memory, p->trained_floats, p->grads) : status;
}

/* ---- statistics ---- */
/* In float32 where one sample makes the step, so that it is the plain update. */
static sherf_status mean_statistics(context *c, step_total *s) {
    const tensor_memory *memory = s->weights->memory;
    float *to = buffers(s);
    if (memory) return memory->blocks->mean_rows(c, s->samples, s->buffers, s->statistics, to);
    for (int64_t k = 0; k < s->buffers; k++) {
        double sum = 0;
        for (int i = 0; i < s->samples; i++) sum += s->statistics[(size_t)i * (size_t)s->buffers + (size_t)k];
        to[k] = (float)(sum / s->samples);
    }
    return SHERF_OK;
}

/* ---- losses ---- */
/* Means over the targets, without those whose value is missing (NaN). */
static void mean_targets(const step_total *s, const float *rows, float mean[LOSSES]) {
    double sum[LOSSES] = {0};
    int count[LOSSES] = {0};
    for (int k = 0; k < s->targets; k++) {
        const loss_values v = losses_values(rows + (size_t)k * LOSSES);
        const double all[LOSSES] = {v.total, v.color, v.mask, v.ssim, v.lpips, v.resnet50};
        for (int i = 0; i < LOSSES; i++) {
            if (isnan(all[i])) continue;
            sum[i] += all[i];
            count[i]++;
        }
    }
    for (int i = 0; i < LOSSES; i++) mean[i] = count[i] ? (float)(sum[i] / count[i]) : NAN;
}

static sherf_status read_losses(context *c, step_total *s) {
    const size_t row = (size_t)s->targets * LOSSES, n = (size_t)(s->end - s->begin) * row;
    float *rows = mem_alloc(c, n, sizeof *rows);
    if (!rows) return SHERF_NO_MEMORY;
    sherf_status status = block_download(c, s->weights->memory, rows, s->rows, n * sizeof *rows);
    for (int i = s->begin; i < s->end && status == SHERF_OK; i++)
        mean_targets(s, rows + (size_t)(i - s->begin) * row, s->losses + (size_t)i * LOSSES);
    mem_free(rows);
    return status;
}

/* Images without a value (a rectangle too small for SSIM) are left out of its mean. */
static double mean_loss(const step_total *s, int which) {
    double sum = 0;
    int n = 0;
    for (int i = 0; i < s->samples; i++) {
        double v = s->losses[(size_t)i * LOSSES + (size_t)which];
        if (isnan(v) && which >= 3) continue;
        sum += v;
        n++;
    }
    return n ? sum / n : NAN;
}

sherf_status total_finish(context *c, step_total *s, const ranks *r, loss_values *mean) {
    const parameters *p = s->weights;
    sherf_status status = sum_gradients(c, s, r);
    if (status == SHERF_OK) status = ranks_sum(c, r, p->memory, s->buffers * s->samples, s->statistics);
    if (status == SHERF_OK) status = mean_statistics(c, s);
    if (status == SHERF_OK) status = read_losses(c, s);
    if (status == SHERF_OK) status = ranks_sum(c, r, NULL, (int64_t)LOSSES * s->samples, s->losses);
    if (status != SHERF_OK) return status;
    *mean = (loss_values){mean_loss(s, 0), mean_loss(s, 1), mean_loss(s, 2),
                          mean_loss(s, 3), mean_loss(s, 4), mean_loss(s, 5)};
    return SHERF_OK;
}
