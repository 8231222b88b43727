/* A training's state, written and read as one safetensors file. */
#include <errno.h>
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/safetensors.h"
#include "tensor/block.h"
#include "train/checkpoint.h"

/* ---- the state as metadata ---- */
enum { STATE_KEYS = 15 };
static const char *const state_keys[STATE_KEYS] = {"step",
                                                   "skipped",
                                                   "updates",
                                                   "seed",
                                                   "batch",
                                                   "size_px",
                                                   "front_view",
                                                   "learning_rate",
                                                   "halve_every",
                                                   "targets",
                                                   "random_background",
                                                   "estimated",
                                                   "pictures",
                                                   "without",
                                                   "beta2"};

static void state_text(const train_state *s, int64_t updates, char text[STATE_KEYS][32]) {
    snprintf(text[0], 32, "%" PRId64, s->step);
    snprintf(text[1], 32, "%" PRId64, s->skipped);
    snprintf(text[2], 32, "%" PRId64, updates);
    snprintf(text[3], 32, "%" PRIu64, s->seed);
    snprintf(text[4], 32, "%d", s->batch);
    snprintf(text[5], 32, "%d", s->size_px);
    snprintf(text[6], 32, "%d", s->front_view);
    snprintf(text[7], 32, "%.17g", s->learning_rate);
    snprintf(text[8], 32, "%" PRId64, s->halve_every);
    snprintf(text[9], 32, "%d", s->targets);
    snprintf(text[10], 32, "%d", s->random_background);
    snprintf(text[11], 32, "%.17g", s->estimated);
    snprintf(text[12], 32, "%d", s->pictures);
    snprintf(text[13], 32, "%u", s->without);
    snprintf(text[14], 32, "%.17g", s->beta2);
}

enum { SIDE_MAX = 4096 }; /* as data sets' pictures are read */

/* Reads a whole number of the state; `otherwise` if the file has none. ALWAYS: the file must have it. */
enum { ALWAYS = -1 };
typedef struct {
    const char *key;
    int64_t low, high, otherwise;
    int64_t *out;
} whole_number;

static sherf_status whole_read(context *c, const safetensors *f, const whole_number *n) {
    const char *text = safetensors_metadata(f, n->key);
    char *end;
    *n->out = n->otherwise;
    if (!text && n->otherwise == ALWAYS)
        return failure(c, SHERF_BAD_FILE,
                       "%s is missing: not a checkpoint of this version of sherf; begin anew", n->key);
    if (!text) return SHERF_OK;
    errno = 0;
    *n->out = strtoll(text, &end, 10);
    if (*text && !*end && !errno && *n->out >= n->low && *n->out <= n->high) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "%s is '%.40s': must be %" PRId64 " to %" PRId64, n->key, text, n->low,
                   n->high);
}

static sherf_status state_whole(context *c, const safetensors *f, train_state *s, int64_t *updates) {
    const int64_t max = (int64_t)1 << 50;
    int64_t batch, size, front, targets, background, pictures, without;
    const whole_number numbers[] = {{"step", 0, max, ALWAYS, &s->step},
                                    {"skipped", 0, max, ALWAYS, &s->skipped},
                                    {"updates", 0, max, ALWAYS, updates},
                                    {"batch", 1, BATCH_MAX, ALWAYS, &batch},
                                    {"size_px", 0, SIDE_MAX, ALWAYS, &size},
                                    {"front_view", 0, 1, ALWAYS, &front},
                                    {"halve_every", 1, max, ALWAYS, &s->halve_every},
                                    {"targets", 1, TARGETS_MAX, 1, &targets},
                                    {"random_background", 0, 1, 0, &background},
                                    {"pictures", 1, OBSERVED_PICTURES_MAX, 1, &pictures},
                                    {"without", 0, LOSS_ALL - 1, 0, &without}};
    for (size_t i = 0; i < COUNT_OF(numbers); i++) {
        sherf_status status = whole_read(c, f, &numbers[i]);
        if (status != SHERF_OK) return status;
    }
    if (s->skipped > s->step || *updates > s->step)
        return failure(c, SHERF_BAD_FILE, "more steps skipped or taken than the %" PRId64 " made", s->step);
    s->batch = (int)batch;
    s->size_px = (int)size;
    s->front_view = (int)front;
    s->targets = (int)targets;
    s->random_background = (int)background;
    s->pictures = (int)pictures;
    s->without = (unsigned)without;
    return SHERF_OK;
}

static sherf_status state_parse(context *c, const safetensors *f, train_state *s, int64_t *updates) {
    const char *seed = safetensors_metadata(f, "seed"), *rate = safetensors_metadata(f, "learning_rate"),
               *share = safetensors_metadata(f, "estimated"), *beta2 = safetensors_metadata(f, "beta2");
    char *end;
    sherf_status status = state_whole(c, f, s, updates);
    if (status != SHERF_OK) return status;
    errno = 0;
    s->seed = seed ? strtoull(seed, &end, 10) : 0;
    if (!seed || !*seed || *end || errno)
        return failure(c, SHERF_BAD_FILE, "seed is missing or not a number");
    s->learning_rate = rate ? strtod(rate, &end) : 0;
    if (!rate || !*rate || *end || !(s->learning_rate > 0) || !isfinite(s->learning_rate))
        return failure(c, SHERF_BAD_FILE, "learning_rate is missing or not a positive number");
    s->estimated = share ? strtod(share, &end) : 0; /* older files have none */
    if (share && (!*share || *end || !(s->estimated >= 0 && s->estimated <= 1)))
        return failure(c, SHERF_BAD_FILE, "estimated is not a share between 0 and 1");
    s->beta2 = beta2 ? strtod(beta2, &end) : 0;
    if (beta2 && (!*beta2 || *end || !(s->beta2 >= 0 && s->beta2 < 1)))
        return failure(c, SHERF_BAD_FILE, "beta2 is not between 0 and 1");
    return SHERF_OK;
}

sherf_status adam_of_model(context *c, const model *m, double beta2, adam *out) {
    const training_recipe *r = model_recipe(&m->config);
    const int64_t n = m->weights->trained_floats;
    sherf_status status = r ? adam_create_with(c, n, r->beta1, r->beta2, out) : adam_create(c, n, out);
    if (beta2 > 0) out->beta2 = beta2;
    return status;
}

/* ---- tensors: the same loop over the groups writes and reads ---- */
enum { GROUPS = 4 };
static const char *const group_names[GROUPS] = {"model", "average", "second", "first"};

/* Buffers have no moments, and where beta1 is 0 there is no first one. */
static bool group_has(const adam *a, int group, const parameter *q) {
    return group < 2 || (!q->buffer && (group < 3 || a->first));
}

/* The groups' blocks, readable by the host; mem_free `copies`, even after an error. */
static sherf_status blocks_read(context *c, const model *m, const model *average, const adam *a,
                                const float *block[GROUPS], float *copies[GROUPS]) {
    sherf_status status = parameters_read(c, m->weights, &block[0], &copies[0]);
    if (status == SHERF_OK) status = parameters_read(c, average->weights, &block[1], &copies[1]);
    block[2] = a->second;
    block[3] = a->first;
    for (int k = 2; k < GROUPS && status == SHERF_OK && a->memory && block[k]; k++) {
        copies[k] = mem_alloc(c, (size_t)a->n, sizeof(float));
        if (!copies[k]) return SHERF_NO_MEMORY;
        status = block_download(c, a->memory, copies[k], block[k], (size_t)a->n * sizeof(float));
        block[k] = copies[k];
    }
    return status;
}

sherf_status checkpoint_write(context *c, const char *path, const model *m, const model *average,
                              const adam *a, const train_state *state) {
    const parameters *p = m->weights;
    const size_t max = (size_t)p->count * GROUPS;
    char text[STATE_KEYS][32];
    size_t n = 0;
    sherf_status status = SHERF_NO_MEMORY;
    safetensor_metadata metadata[STATE_KEYS + 4] = {
        SAFETENSORS_CHECKSUM, {"format", "sherf-checkpoint"}, {"model", m->config.kind->name}};
    char *config = model_config_text(c, &m->config);
    char(*name)[288] = mem_alloc(c, max, sizeof *name);
    safetensor_item *item = mem_zero(c, max, sizeof *item);
    const float *block[GROUPS] = {NULL};
    float *copies[GROUPS] = {NULL};
    if (!config || !name || !item) goto done;
    if ((status = blocks_read(c, m, average, a, block, copies)) != SHERF_OK) goto done;
    metadata[3] = (safetensor_metadata){"config", config};
    state_text(state, a->updates, text);
    for (int i = 0; i < STATE_KEYS; i++) metadata[i + 4] = (safetensor_metadata){state_keys[i], text[i]};
    for (int group = 0; group < GROUPS; group++)
        for (int i = 0; i < p->count; i++) {
            const parameter *q = p->item[i];
            if (!group_has(a, group, q)) continue;
            const float *values = block[group] + q->offset;
            snprintf(name[n], sizeof name[n], "%s.%s", group_names[group], q->name);
            item[n] =
                (safetensor_item){.name = name[n], .type = T_F32, .rank = q->value.rank, .data = values};
            memcpy(item[n].dim, q->value.dim, sizeof item[n].dim);
            n++;
        }
    status = safetensors_write(c, path, n, item, COUNT_OF(metadata), metadata);
done:
    for (int group = 0; group < GROUPS; group++) mem_free(copies[group]);
    mem_free(config);
    mem_free(name);
    mem_free(item);
    return status;
}

/* Into arrays of the host. */
static sherf_status tensors_read(context *c, const safetensors *f, const model *m, const model *average,
                                 const adam *a) {
    const parameters *p = m->weights;
    float *const block[GROUPS] = {p->values, average->weights->values, a->second, a->first};
    char name[288];
    for (int group = 0; group < GROUPS; group++)
        for (int i = 0; i < p->count; i++) {
            const parameter *q = p->item[i];
            if (!group_has(a, group, q)) continue;
            float *values = block[group] + q->offset;
            snprintf(name, sizeof name, "%s.%s", group_names[group], q->name);
            sherf_status status = safetensors_floats(c, f, name, q->value.rank, q->value.dim, values);
            for (int64_t k = 0; k < tensor_count(&q->value) && status == SHERF_OK; k++)
                if (!isfinite(values[k]))
                    status = failure(c, SHERF_BAD_FILE, "tensor %s holds a number that is not finite", name);
            if (status != SHERF_OK) return status;
        }
    return SHERF_OK;
}

sherf_status checkpoint_read(context *c, const char *path, model **m, model **average, adam *a,
                             train_state *state) {
    safetensors *f = NULL;
    model_config config;
    int64_t updates = 0;
    *m = *average = NULL;
    *a = (adam){0};
    *state = (train_state){0};
    sherf_status status = safetensors_read(c, path, &f);
    if (status != SHERF_OK) return status; /* names the file itself */
    const char *format = safetensors_metadata(f, "format"), *text = safetensors_metadata(f, "config");
    if (!format || strcmp(format, "sherf-checkpoint") || !text) {
        status = failure(c, SHERF_BAD_FILE, "not a checkpoint of a training");
        goto done;
    }
    if ((status = model_config_of_file(c, f, "config", false, &config)) != SHERF_OK) goto done;
    if ((status = state_parse(c, f, state, &updates)) != SHERF_OK) goto done;
    if ((status = model_create(c, &config, 0, m)) != SHERF_OK) goto done;
    if ((status = model_create(c, &config, 0, average)) != SHERF_OK) goto done;
    if ((status = adam_of_model(c, *m, state->beta2, a)) != SHERF_OK) goto done;
    a->updates = updates;
    status = tensors_read(c, f, *m, *average, a);
done:
    safetensors_free(f);
    if (status != SHERF_OK) {
        failure_prefix(c, status, "%s", path);
        model_free(*m);
        model_free(*average);
        *m = *average = NULL;
        adam_free(a);
    }
    return status;
}
