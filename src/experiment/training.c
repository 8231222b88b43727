/* Trainings, each of which ends with a finished file, and their numbers of steps. */
#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "experiment/experiment.h"
#include "io/value.h"
#include "model/model.h"

static const int64_t never = (int64_t)1 << 40;

/* ---- a training's log ---- */
/* The seconds of a log's steps, in order; mem_free them. */
static sherf_status log_seconds(context *c, const char *path, double **out, int *count) {
    unsigned char *text = NULL;
    size_t bytes, lines = 1;
    *out = NULL;
    *count = 0;
    sherf_status status = file_read(c, path, (size_t)1 << 30, &text, &bytes);
    if (status != SHERF_OK) return status;
    for (size_t i = 0; i < bytes; i++) lines += text[i] == '\n';
    double *list = mem_alloc(c, lines, sizeof *list);
    for (char *p = (char *)text, *found; list && (found = strstr(p, "\"seconds\": ")); p = found + 1)
        if (*count < (int)lines) list[(*count)++] = strtod(found + strlen("\"seconds\": "), NULL);
    mem_free(text);
    *out = list;
    return list ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status log_median(context *c, const char *path, double *seconds) {
    double *list;
    int n;
    sherf_status status = log_seconds(c, path, &list, &n);
    if (status != SHERF_OK) return status;
    numbers_sort(n, list);
    *seconds = n ? list[n / 2] : 0;
    mem_free(list);
    return n ? SHERF_OK : failure(c, SHERF_BAD_FILE, "%s: no step in it", path);
}

/* ---- trainings ---- */
static sherf_train_options training_options(const experiment_job *j, const run *r, const char *folder,
                                            int64_t steps) {
    const sherf_experiment_options *o = j->options;
    const experiment_settings *s = &j->set;
    const bool own = r->method->own;
    const int resnet = r->method->resnet[s->scale];
    const int64_t halve = s->halve_pictures ? 0 : steps / 5 > 1 ? steps / 5 : 1;
    return (sherf_train_options){.data = r->data->train,
                                 .people = data_train_people(j, r->data),
                                 .body = r->data->body,
                                 .output = folder,
                                 .preset = r->method->preset[s->scale],
                                 .resnet = resnet == 34   ? o->resnet34
                                           : resnet == 18 ? o->resnet18
                                                          : NULL,
                                 .lpips = o->lpips,
                                 .perceptual = o->perceptual,
                                 .front_view = r->method->front_view,
                                 .size_px = s->size_px,
                                 .steps = steps,
                                 .batch = own ? 0 : s->batch,
                                 .targets = own ? 0 : s->targets,
                                 .halve_every = own ? 0 : halve,
                                 .halve_pictures = own ? 0 : s->halve_pictures,
                                 .beta2 = own ? 0 : s->beta2,
                                 .learning_rate = own ? 0 : r->method->rate,
                                 .without = r->method->without,
                                 .sample_every = never,
                                 .seed = o->seed + (uint64_t)r->seed + 1};
}

static sherf_status number_read(context *c, const char *path, const char *key, double *out) {
    document *d = NULL;
    sherf_status status = json_read(c, path, &d);
    if (status != SHERF_OK) return status;
    const value *v = value_get(d->root, key);
    status = value_doubles(c, v, key, 1, out);
    document_free(d);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

/* ---- the number of steps that fit in the given minutes ---- */
/* Trains a few steps in a temporary folder; *seconds becomes their median if it is lower. */
static sherf_status step_measure(experiment_job *j, const run *r, double *seconds) {
    enum { STEPS_MAX = 1000 };
    char folder[PATH_LENGTH], log[PATH_LENGTH];
    double median;
    sherf_status status = job_path(j, folder, "steps/pilot");
    if (status == SHERF_OK) status = job_path(j, log, "steps/pilot/log.jsonl");
    if (status != SHERF_OK) return status;
    folder_remove(folder);
    sherf_train_options o = training_options(j, r, folder, STEPS_MAX);
    o.seconds = fmax(0.2, fmin(6, 3 * j->set.minutes));
    status = sherf_train(j->c, &o);
    if (status == SHERF_OK) status = log_median(j->c, log, &median);
    if (status == SHERF_OK) *seconds = fmin(*seconds, median);
    folder_remove(folder);
    return status;
}

static sherf_status steps_path(const experiment_job *j, const run *r, char path[PATH_LENGTH]) {
    return job_path(j, path, "steps/%s-%s.json", r->data->key,
                    r->method->steps_of ? r->method->steps_of : r->method->key);
}

static sherf_status steps_of(experiment_job *j, const run *r, int64_t *steps) {
    char path[PATH_LENGTH];
    double known = 0;
    *steps = j->set.steps;
    if (*steps) return SHERF_OK;
    sherf_status status = steps_path(j, r, path);
    if (status == SHERF_OK) status = number_read(j->c, path, "steps", &known);
    if (status != SHERF_OK) return status;
    *steps = known >= 1 && known < 1e12 ? (int64_t)known : 0;
    return *steps ? SHERF_OK : failure(j->c, SHERF_BAD_FILE, "%s: steps are out of range", path);
}

static sherf_status steps_write(const experiment_job *j, const run *r, double step_s) {
    char path[PATH_LENGTH], text[128];
    const double steps = floor(fmax(1, 60 * j->set.minutes / step_s));
    snprintf(text, sizeof text, "{\"steps\": %.0f, \"step_s\": %.6g}\n", steps, step_s);
    const sherf_status status = steps_path(j, r, path);
    return status == SHERF_OK ? file_write(j->c, path, text, strlen(text)) : status;
}

/* Finds the run whose step is measured for run r. False if that is known or r is not trained. */
static bool step_is_wanted(const experiment_job *j, const run *r, const run *list, int count, run *out) {
    char path[PATH_LENGTH], finished[PATH_LENGTH];
    *out = (run){r->method->steps_of ? experiment_method_find(r->method->steps_of) : r->method, r->data, 0};
    for (int i = 0; i < count; i++)
        if (list[i].method == out->method && list[i].data == out->data) return false;
    return steps_path(j, r, path) == SHERF_OK && !path_is_file(path) &&
           run_path(j, r, "finished.json", finished) == SHERF_OK && !path_is_file(finished);
}

/* Measures all unknown ones in turn, three times, so that other work on the machine affects each equally. A
 * method's lowest median counts. */
sherf_status steps_ready(experiment_job *j) {
    enum { RUNS_MAX = 2 * EXPERIMENT_METHODS, ROUNDS = 3 };
    run wanted[RUNS_MAX], r, one;
    double step_s[RUNS_MAX];
    int count = 0;
    sherf_status status = SHERF_OK;
    for (int i = 0; !j->set.steps && count < RUNS_MAX && run_at(j, i, &r); i++)
        if (step_is_wanted(j, &r, wanted, count, &one)) step_s[count] = INFINITY, wanted[count++] = one;
    if (count)
        log_line(j->c, SHERF_LOG_INFO, "%s: steps are measured, of %d methods in turn", j->experiment->name,
                 count);
    for (int k = 0; k < ROUNDS * count && status == SHERF_OK; k++)
        status = step_measure(j, &wanted[k % count], &step_s[k % count]);
    for (int i = 0; i < count && status == SHERF_OK; i++) status = steps_write(j, &wanted[i], step_s[i]);
    return status;
}

/* ---- a training ---- */
static sherf_status weights_count(context *c, const char *path, double *out) {
    model *m = NULL;
    sherf_status status = model_load(c, path, &m);
    if (status == SHERF_OK) *out = (double)parameters_trained_count(m->weights);
    model_free(m);
    return status;
}

sherf_status training_step_pictures(const experiment_job *j, const experiment_method *method, int *out) {
    model_config config;
    *out = j->set.batch * j->set.targets;
    if (!method->own) return SHERF_OK;
    sherf_status status = model_config_parse(j->c, method->preset[j->set.scale], &config);
    if (status == SHERF_OK) *out = model_recipe(&config)->batch;
    return status;
}

/* Writes finished.json, which marks a complete training. */
static sherf_status training_finish(experiment_job *j, const run *r, const sherf_train_options *o,
                                    const char *path) {
    char log[PATH_LENGTH], weights_path[PATH_LENGTH], text[512];
    double *seconds = NULL, sum = 0, median = 0, weights = 0;
    int n = 0, pictures = 0;
    sherf_status status = run_path(j, r, "log.jsonl", log);
    if (status == SHERF_OK) status = run_path(j, r, "model.safetensors", weights_path);
    if (status == SHERF_OK) status = log_seconds(j->c, log, &seconds, &n);
    if (status == SHERF_OK) status = log_median(j->c, log, &median);
    if (status == SHERF_OK) status = weights_count(j->c, weights_path, &weights);
    if (status == SHERF_OK) status = training_step_pictures(j, r->method, &pictures);
    for (int i = 0; i < n; i++) sum += seconds[i];
    mem_free(seconds);
    if (status != SHERF_OK) return status;
    snprintf(text, sizeof text,
             "{\"steps\": %" PRId64 ", \"pictures\": %" PRId64
             ", \"minutes\": %.6g, \"step_ms\": %.6g, \"weights\": %.0f, \"seed\": %" PRIu64 "}\n",
             o->steps, o->steps * pictures, sum / 60, 1000 * median, weights, o->seed);
    return file_write(j->c, path, text, strlen(text));
}

sherf_status training_read(const experiment_job *j, const run *r, training_facts *out) {
    char path[PATH_LENGTH];
    sherf_status status = run_path(j, r, "finished.json", path);
    if (status == SHERF_OK) status = number_read(j->c, path, "steps", &out->steps);
    if (status == SHERF_OK) status = number_read(j->c, path, "pictures", &out->pictures);
    if (status == SHERF_OK) status = number_read(j->c, path, "minutes", &out->minutes);
    if (status == SHERF_OK) status = number_read(j->c, path, "step_ms", &out->step_ms);
    return status == SHERF_OK ? number_read(j->c, path, "weights", &out->weights) : status;
}

sherf_status training_do(experiment_job *j, const run *r) {
    char finished[PATH_LENGTH], folder[PATH_LENGTH];
    int64_t steps;
    sherf_status status = run_path(j, r, "finished.json", finished);
    if (status == SHERF_OK)
        status = job_path(j, folder, "runs/%s/%s-%d", r->data->key, r->method->key, r->seed + 1);
    if (status != SHERF_OK || path_is_file(finished)) return status;
    run_tell(j, r, "training");
    const double begun = time_seconds();
    status = steps_of(j, r, &steps);
    if (status != SHERF_OK) return status;
    const sherf_train_options o = training_options(j, r, folder, steps);
    status = sherf_train(j->c, &o);
    if (status == SHERF_OK) status = training_finish(j, r, &o, finished);
    j->trainings_left--;
    if (!j->set.minutes) j->training_s = time_seconds() - begun;
    return status;
}
