#include <math.h>
#include <string.h>

#include "train/trainer.h"

void total_free(step_total *s) {
    for (int i = 0; s->branch && i < s->levels; i++) mem_free(s->branch[i]);
    mem_free(s->branch);
    mem_free(s->full);
    mem_free(s->before);
    mem_free(s->by_image);
    *s = (step_total){0};
}

sherf_status total_create(context *c, parameters *weights, int images, int begin, int end, step_total *out) {
    *out = (step_total){.weights = weights, .images = images, .begin = begin, .end = end, .levels = 1};
    while ((end - begin) >> out->levels) out->levels++;
    out->buffers = weights->total_floats - weights->trained_floats;
    size_t row = (size_t)out->buffers + TOTAL_LOSSES;
    out->branch = mem_zero(c, (size_t)out->levels, sizeof *out->branch);
    out->full = mem_zero(c, (size_t)out->levels, sizeof *out->full);
    out->before = mem_alloc(c, (size_t)out->buffers, sizeof *out->before);
    out->by_image = mem_alloc(c, (size_t)images, row * sizeof *out->by_image);
    if (out->branch && out->full && out->before && out->by_image) return SHERF_OK;
    total_free(out);
    return SHERF_NO_MEMORY;
}

static float *buffers(const step_total *s) {
    return s->weights->values + s->weights->trained_floats;
}

void total_start(step_total *s) {
    parameters_zero_grads(s->weights);
    memset(s->full, 0, (size_t)s->levels * sizeof *s->full);
    memcpy(s->before, buffers(s), (size_t)s->buffers * sizeof(float));
    memset(s->by_image, 0, (size_t)s->images * ((size_t)s->buffers + TOTAL_LOSSES) * sizeof(float));
}

void total_undo(step_total *s) {
    memcpy(buffers(s), s->before, (size_t)s->buffers * sizeof(float));
}

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

static void move(context *c, float *to, const float *from, int64_t n, bool add) {
    move_job job = {to, from, add};
    parallel_for(c, n, 1 << 14, move_range, &job);
}

/* Into the gradients: every finished branch below `level`, smallest first. */
static int gather(context *c, step_total *s) {
    int level = 0;
    for (; level < s->levels && s->full[level]; level++) {
        move(c, s->weights->grads, s->branch[level], s->weights->trained_floats, true);
        s->full[level] = false;
    }
    return level;
}

sherf_status total_add(context *c, step_total *s, int image, const loss_values *v) {
    const int64_t n = s->weights->trained_floats;
    float *row = s->by_image + (size_t)image * ((size_t)s->buffers + TOTAL_LOSSES);
    const float losses[TOTAL_LOSSES] = {(float)v->total, (float)v->color, (float)v->mask,
                                        (float)v->ssim,  (float)v->lpips, (float)v->resnet50};
    memcpy(row, losses, sizeof losses);
    memcpy(row + TOTAL_LOSSES, buffers(s), (size_t)s->buffers * sizeof(float));
    if (image + 1 == s->end) return SHERF_OK; /* the last one stays where it is */
    total_undo(s);
    int level = gather(c, s);
    if (!s->branch[level] && !(s->branch[level] = mem_alloc(c, (size_t)n, sizeof(float))))
        return SHERF_NO_MEMORY;
    move(c, s->branch[level], s->weights->grads, n, false);
    s->full[level] = true;
    parameters_zero_grads(s->weights);
    return SHERF_OK;
}

/* In float32 where one image makes the step, so that it is the plain update. */
static void mean_buffers(step_total *s) {
    const size_t row = (size_t)s->buffers + TOTAL_LOSSES;
    float *to = buffers(s);
    for (int64_t k = 0; k < s->buffers; k++) {
        double sum = 0;
        for (int i = 0; i < s->images; i++) sum += s->by_image[(size_t)i * row + TOTAL_LOSSES + (size_t)k];
        to[k] = (float)(sum / s->images);
    }
}

/* Images without a value (a rectangle too small for SSIM) are left out of its mean. */
static double mean_loss(const step_total *s, int which) {
    const size_t row = (size_t)s->buffers + TOTAL_LOSSES;
    double sum = 0;
    int n = 0;
    for (int i = 0; i < s->images; i++) {
        double v = s->by_image[(size_t)i * row + (size_t)which];
        if (isnan(v) && which >= 3) continue;
        sum += v;
        n++;
    }
    return n ? sum / n : NAN;
}

sherf_status total_finish(context *c, step_total *s, const ranks *r, loss_values *mean) {
    const int64_t n = s->weights->trained_floats;
    for (int level = 0; level < s->levels; level++)
        if (s->full[level]) move(c, s->weights->grads, s->branch[level], n, true);
    sherf_status status = ranks_sum(c, r, n, s->weights->grads);
    if (status == SHERF_OK) status = ranks_sum(c, r, (s->buffers + TOTAL_LOSSES) * s->images, s->by_image);
    if (status != SHERF_OK) return status;
    mean_buffers(s);
    *mean = (loss_values){mean_loss(s, 0), mean_loss(s, 1), mean_loss(s, 2),
                          mean_loss(s, 3), mean_loss(s, 4), mean_loss(s, 5)};
    return SHERF_OK;
}
