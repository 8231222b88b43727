/* Trainings and scorings, each left as a finished file. */
#include <cjson/cJSON.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "eval/protocol.h"
#include "experiment/disturb.h"
#include "experiment/experiment.h"
#include "io/value.h"
#include "model/model.h"

static const int64_t never = (int64_t)1 << 40;

/* ---- which, and where ---- */
sherf_status job_path(const experiment_job *j, char out[PATH_LENGTH], const char *format, ...) {
    va_list args;
    int n = snprintf(out, PATH_LENGTH, "%s/", j->options->output);
    va_start(args, format);
    if (n < PATH_LENGTH) n += vsnprintf(out + n, (size_t)(PATH_LENGTH - n), format, args);
    va_end(args);
    if (n < PATH_LENGTH) return SHERF_OK;
    return failure(j->c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", j->options->output);
}

static bool trains_on(const experiment_job *j, int i) {
    const experiment *e = j->experiment;
    if (e->all_data) return !j->data[i].only_crossed;
    return i == 0 || (e->both_ways && i == 1);
}

bool run_at(const experiment_job *j, int i, run *out) {
    const experiment *e = j->experiment;
    const int seeds = e->all_seeds ? j->set.seeds : 1;
    for (int d = 0; d < j->data_count; d++)
        for (int m = 0; m < EXPERIMENT_METHODS && e->method[m] && trains_on(j, d); m++) {
            const experiment_method *method = experiment_method_find(e->method[m]);
            if (method->own && !j->options->own) continue;
            if (i < seeds) {
                *out = (run){method, &j->data[d], i};
                return true;
            }
            i -= seeds;
        }
    return false;
}

bool run_has(const run *r, const scoring *s) {
    if (s->kind == SCORING_POSES && r->method->one_pose) return false;
    return (s->kind != SCORING_VIEWS && s->kind != SCORING_POSES) || r->seed == 0;
}

const experiment_data *scoring_data(const experiment_job *j, const run *r, const scoring *s) {
    return s->crossed ? &j->data[r->data == &j->data[0]] : r->data;
}

sherf_status run_path(const experiment_job *j, const run *r, const char *name, char out[PATH_LENGTH]) {
    return job_path(j, out, "runs/%s/%s-%d/%s", r->data->key, r->method->key, r->seed + 1, name);
}

sherf_status scoring_path(const experiment_job *j, const run *r, const scoring *s, int pose, const char *name,
                          char out[PATH_LENGTH]) {
    static const char *const kind[SCORING_KINDS] = {"protocol",  "front", "angles", "estimated",
                                                    "disturbed", "views", "poses"};
    char part[200];
    size_t n = (size_t)snprintf(part, sizeof part, "scores/%s", kind[s->kind]);
    if (s->level) n += (size_t)snprintf(part + n, sizeof part - n, "-%d", s->level);
    if (s->crossed) n += (size_t)snprintf(part + n, sizeof part - n, "-on-%s", scoring_data(j, r, s)->key);
    if (s->kind == SCORING_ANGLES) n += (size_t)snprintf(part + n, sizeof part - n, "-%d", pose);
    snprintf(part + n, sizeof part - n, "/%s", name);
    return run_path(j, r, part, out);
}

/* ---- how long a step takes ---- */
static int by_value(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

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
    qsort(list, (size_t)n, sizeof *list, by_value);
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
    int64_t halve = s->halve_every ? s->halve_every : steps / 5 > 1 ? steps / 5 : 1;
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
                                 .images_per_step = own ? 0 : s->images,
                                 .targets = own ? 0 : s->targets,
                                 .halve_every = own ? 0 : halve,
                                 .sample_every = never,
                                 .seed = o->seed + (uint64_t)r->seed + 1};
}

/* A few steps of it in a folder that goes again. */
static sherf_status step_measure(experiment_job *j, const run *r, double *seconds) {
    char folder[PATH_LENGTH], log[PATH_LENGTH];
    sherf_status status = job_path(j, folder, "steps/pilot");
    if (status == SHERF_OK) status = job_path(j, log, "steps/pilot/log.jsonl");
    if (status != SHERF_OK) return status;
    folder_remove(folder);
    sherf_train_options o = training_options(j, r, folder, never);
    o.seconds = fmax(1, fmin(15, 60 * j->set.minutes / 20));
    status = sherf_train(j->c, &o);
    if (status == SHERF_OK) status = log_median(j->c, log, seconds);
    folder_remove(folder);
    return status;
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

/* How many steps a training of this method takes: the same for all seeds, so measured once. */
static sherf_status steps_of(experiment_job *j, const run *r, int64_t *steps) {
    char path[PATH_LENGTH], text[128];
    double step_s, known;
    *steps = j->set.steps;
    if (*steps) return SHERF_OK;
    const experiment_method *of =
        r->method->steps_of ? experiment_method_find(r->method->steps_of) : r->method;
    sherf_status status = job_path(j, path, "steps/%s-%s.json", r->data->key, of->key);
    if (status != SHERF_OK) return status;
    if (path_is_file(path)) {
        if ((status = number_read(j->c, path, "steps", &known)) != SHERF_OK) return status;
        *steps = known >= 1 && known < 1e12 ? (int64_t)known : 0;
        return *steps ? SHERF_OK : failure(j->c, SHERF_BAD_FILE, "%s: steps are out of range", path);
    }
    if ((status = step_measure(j, &(run){of, r->data, 0}, &step_s)) != SHERF_OK) return status;
    *steps = (int64_t)fmax(1, 60 * j->set.minutes / step_s);
    snprintf(text, sizeof text, "{\"steps\": %" PRId64 ", \"step_s\": %.6g}\n", *steps, step_s);
    return file_write(j->c, path, text, strlen(text));
}

static sherf_status weights_count(context *c, const char *path, double *out) {
    model *m = NULL;
    sherf_status status = model_load(c, path, &m);
    if (status == SHERF_OK) *out = (double)parameters_trained_count(m->weights);
    model_free(m);
    return status;
}

/* finished.json, the sign that a training is whole. */
static sherf_status training_finish(experiment_job *j, const run *r, const sherf_train_options *o,
                                    const char *path) {
    char log[PATH_LENGTH], weights_path[PATH_LENGTH], text[512];
    double *seconds = NULL, sum = 0, median = 0, weights = 0;
    int n = 0;
    sherf_status status = run_path(j, r, "log.jsonl", log);
    if (status == SHERF_OK) status = run_path(j, r, "model.safetensors", weights_path);
    if (status == SHERF_OK) status = log_seconds(j->c, log, &seconds, &n);
    if (status == SHERF_OK) status = log_median(j->c, log, &median);
    if (status == SHERF_OK) status = weights_count(j->c, weights_path, &weights);
    for (int i = 0; i < n; i++) sum += seconds[i];
    mem_free(seconds);
    if (status != SHERF_OK) return status;
    model_config config;
    status = model_config_parse(j->c, o->preset, &config);
    if (status != SHERF_OK) return status;
    const training_recipe *own = model_recipe(&config);
    const int images = o->images_per_step ? o->images_per_step : own ? own->images : 4;
    snprintf(text, sizeof text,
             "{\"steps\": %" PRId64 ", \"pictures\": %" PRId64
             ", \"minutes\": %.6g, \"step_ms\": %.6g, \"weights\": %.0f, \"seed\": %" PRIu64 "}\n",
             o->steps, o->steps * images * (o->targets ? o->targets : 1), sum / 60, 1000 * median, weights,
             o->seed);
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

static void tell(experiment_job *j, const run *r, const char *what) {
    const double left = j->trainings_left * j->training_s + (double)j->pictures_left * j->picture_s;
    log_line(j->c, SHERF_LOG_INFO, "%s: %s on %s, seed %d: %s (about %.0f min left)", j->experiment->name,
             r->method->label, r->data->label, r->seed + 1, what, ceil(left / 60));
}

static sherf_status train(experiment_job *j, const run *r) {
    char finished[PATH_LENGTH], folder[PATH_LENGTH];
    int64_t steps;
    sherf_status status = run_path(j, r, "finished.json", finished);
    if (status == SHERF_OK)
        status = job_path(j, folder, "runs/%s/%s-%d", r->data->key, r->method->key, r->seed + 1);
    if (status != SHERF_OK || path_is_file(finished)) return status;
    tell(j, r, "training");
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

/* ---- scorings ---- */
/* Bodies of the first observed pose of some test people. */
static sherf_status disturbance_make(experiment_job *j, const experiment_data *d, int mm, sherf_body *body,
                                     disturbance *out) {
    enum { BODIES = 8 };
    sherf_camera camera[BODIES];
    sherf_pose pose[BODIES];
    sherf_dataset *data = NULL;
    int *person = NULL, count = 0;
    *out = (disturbance){.body = body};
    sherf_status status = sherf_dataset_open(j->c, d->test, &data);
    if (status == SHERF_OK)
        status = dataset_people(j->c, data, data_test_people(j, d), false, &person, &count);
    if (count > BODIES) count = BODIES;
    for (int i = 0; i < count && status == SHERF_OK; i++) {
        status = dataset_camera(j->c, data, person[i], 0, &camera[i]);
        if (status == SHERF_OK)
            status = dataset_pose(j->c, data, person[i], dataset_protocol(data)->pose_first, &pose[i]);
    }
    if (status == SHERF_OK)
        status = disturbance_for(j->c, body, count, camera, pose, mm, &out->deviation_rad);
    mem_free(person);
    sherf_dataset_free(data);
    return status;
}

static sherf_status evaluate(experiment_job *j, const experiment_data *d, const scoring *s,
                             const sherf_eval_options *o) {
    sherf_scores result = {0};
    sherf_body *body = NULL;
    disturbance how;
    sherf_status status = SHERF_OK;
    if (s->kind == SCORING_DISTURBED) {
        status = sherf_body_load(j->c, d->body, &body);
        if (status == SHERF_OK) status = disturbance_make(j, d, s->level, body, &how);
        if (status == SHERF_OK)
            status = eval_run(j->c, o, &(eval_estimator){estimate_by_disturbance, &how}, &result);
    } else {
        status = sherf_eval(j->c, o, &result);
    }
    sherf_free(result.table);
    sherf_body_free(body);
    return status;
}

static const char *unless_empty(const char *text) {
    return *text ? text : NULL;
}

static sherf_status score(experiment_job *j, const run *r, const scoring *s, int pose,
                          const scoring_selection *k) {
    const experiment_data *d = scoring_data(j, r, s);
    const bool looks = s->kind == SCORING_VIEWS || s->kind == SCORING_POSES;
    char folder[PATH_LENGTH], weights[PATH_LENGTH], sheet[PATH_LENGTH];
    sherf_status status = scoring_path(j, r, s, pose, "", folder);
    if (status == SHERF_OK) status = scoring_path(j, r, s, pose, "sheet.png", sheet);
    if (status == SHERF_OK) status = run_path(j, r, "model.safetensors", weights);
    if (status != SHERF_OK) return status;
    folder[strlen(folder) - 1] = 0; /* its slash */
    const sherf_eval_options o = {.data = d->test,
                                  .people = unless_empty(k->people),
                                  .body = d->body,
                                  .model = weights,
                                  .lpips = j->options->lpips,
                                  .perceptual = j->options->perceptual,
                                  .observations = unless_empty(k->observations),
                                  .poses = unless_empty(k->poses),
                                  .views = unless_empty(k->views),
                                  .output = folder,
                                  .size_px = j->set.size_px,
                                  .seed = j->options->seed,
                                  .sheet = looks ? sheet : NULL,
                                  .estimated = s->kind == SCORING_ESTIMATED ? j->options->estimator : NULL};
    tell(j, r, looks ? "pictures to look at" : "scoring");
    const double begun = time_seconds();
    status = evaluate(j, d, s, &o);
    if (status != SHERF_OK) return status;
    j->pictures_left -= k->pictures;
    j->picture_s = (time_seconds() - begun) / (double)k->pictures;
    return SHERF_OK;
}

/* Calls `once` for every scoring of a run, of each pose, that is not there yet. */
typedef sherf_status scoring_function(experiment_job *j, const run *r, const scoring *s, int pose,
                                      const scoring_selection *k, void *arg);
static sherf_status scorings_of(experiment_job *j, const run *r, scoring_function *once, void *arg) {
    const experiment *e = j->experiment;
    for (int i = 0; i < e->scorings; i++) {
        const scoring *s = &e->scoring[i];
        scoring_selection k;
        char path[PATH_LENGTH];
        for (int pose = 0; run_has(r, s) && (!pose || pose < k.poses_observed); pose++) {
            sherf_status status = scoring_select(j, scoring_data(j, r, s), s, pose, &k);
            if (status == SHERF_OK) status = scoring_path(j, r, s, pose, "scores.json", path);
            if (status == SHERF_OK && k.pictures && !path_is_file(path))
                status = once(j, r, s, pose, &k, arg);
            if (status != SHERF_OK) return status;
        }
    }
    return SHERF_OK;
}

static sherf_status score_once(experiment_job *j, const run *r, const scoring *s, int pose,
                               const scoring_selection *k, void *arg) {
    return score(j, r, s, pose, k);
}

static sherf_status count_once(experiment_job *j, const run *r, const scoring *s, int pose,
                               const scoring_selection *k, void *arg) {
    j->pictures_left += k->pictures;
    return SHERF_OK;
}

/* ---- all of an experiment ---- */
const char *experiment_lack(const experiment_job *j, const experiment *e) {
    if (e->lacks) return e->lacks;
    for (int i = 0; i < e->scorings; i++) {
        if (e->scoring[i].kind == SCORING_ESTIMATED && !j->options->estimator)
            return "the networks that see people in photos";
        if (e->scoring[i].crossed && j->data_count < 2) return "two data sets";
    }
    return NULL;
}

static sherf_status data_ready(experiment_job *j) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < j->data_count && status == SHERF_OK; i++)
        if (trains_on(j, i)) status = data_make(j, &j->data[i]);
    return status;
}

static sherf_status count_left(experiment_job *j) {
    run r;
    char path[PATH_LENGTH];
    j->trainings_left = 0;
    j->pictures_left = 0;
    for (int i = 0; run_at(j, i, &r); i++) {
        sherf_status status = run_path(j, &r, "finished.json", path);
        if (status == SHERF_OK) status = scorings_of(j, &r, count_once, NULL);
        if (status != SHERF_OK) return status;
        j->trainings_left += !path_is_file(path);
    }
    return SHERF_OK;
}

sherf_status runs_do(experiment_job *j) {
    run r;
    char path[PATH_LENGTH];
    sherf_status status = data_ready(j);
    if (status == SHERF_OK) status = job_path(j, path, "steps");
    if (status == SHERF_OK) status = folder_make(j->c, path);
    if (status == SHERF_OK) status = count_left(j);
    for (int i = 0; status == SHERF_OK && run_at(j, i, &r); i++) {
        status = train(j, &r);
        if (status == SHERF_OK) status = scorings_of(j, &r, score_once, NULL);
    }
    return status;
}

/* ---- dry runs ---- */
static bool first_time(context *c, run_tally *t, const char *path, sherf_status *status) {
    for (int i = 0; i < t->count; i++)
        if (!strcmp(t->seen[i], path)) return false;
    if (t->count == t->capacity) {
        const int capacity = t->capacity ? 2 * t->capacity : 64;
        void *grown = mem_grow(c, t->seen, (size_t)t->count, (size_t)capacity, sizeof *t->seen);
        if (!grown) {
            *status = SHERF_NO_MEMORY;
            return false;
        }
        t->seen = grown;
        t->capacity = capacity;
    }
    snprintf(t->seen[t->count++], sizeof *t->seen, "%s", path);
    return true;
}

/* The milliseconds that `sherf bench` measures. */
static sherf_status bench_ms(experiment_job *j, const char *preset, const char *what, const char *key,
                             double *ms) {
    const sherf_bench_options o = {
        .preset = preset, .size_px = j->set.size_px ? j->set.size_px : 512, .repeats = 3, .json = 1};
    char *text = NULL;
    document *d = NULL;
    sherf_status status = sherf_bench(j->c, what, &o, &text);
    if (status == SHERF_OK) status = json_parse(j->c, text, strlen(text), &d);
    if (status == SHERF_OK) status = value_doubles(j->c, value_get(d->root, key), key, 1, ms);
    document_free(d);
    mem_free(text);
    return status;
}

/* Timed once, as long as there is room to remember it. */
static sherf_status preset_timed(experiment_job *j, const char *preset, run_tally *t, preset_time *out) {
    for (int i = 0; i < t->timed_count; i++)
        if (!strcmp(t->timed[i].preset, preset)) {
            *out = t->timed[i];
            return SHERF_OK;
        }
    const char *step = j->options->lpips        ? "step_lpips_ms"
                       : j->options->perceptual ? "step_resnet50_ms"
                                                : "step_ms";
    *out = (preset_time){.preset = preset};
    sherf_status status = bench_ms(j, preset, "train", step, &out->step_ms);
    if (status == SHERF_OK) status = bench_ms(j, preset, "render", "frame_ms", &out->frame_ms);
    if (status == SHERF_OK && t->timed_count < (int)COUNT_OF(t->timed)) t->timed[t->timed_count++] = *out;
    return status;
}

typedef struct {
    run_tally *tally;
    int64_t pictures;
} tell_state;

static sherf_status tell_scoring(experiment_job *j, const run *r, const scoring *s, int pose,
                                 const scoring_selection *k, void *arg) {
    tell_state *state = arg;
    char path[PATH_LENGTH];
    sherf_status status = scoring_path(j, r, s, pose, "scores.json", path);
    if (status == SHERF_OK && first_time(j->c, state->tally, path + strlen(j->options->output), &status))
        state->pictures += k->pictures;
    return status;
}

/* Minutes are those of the method whose number of steps this one takes. */
static sherf_status training_hours(experiment_job *j, const run *r, run_tally *t, double step_ms,
                                   double *hours) {
    const experiment_settings *s = &j->set;
    *hours = s->minutes / 60;
    if (!(s->minutes > 0)) *hours = (double)s->steps * s->images * s->targets * step_ms / 3.6e6;
    if (!(s->minutes > 0) || !r->method->steps_of) return SHERF_OK;
    preset_time of;
    sherf_status status =
        preset_timed(j, experiment_method_find(r->method->steps_of)->preset[s->scale], t, &of);
    *hours *= step_ms / of.step_ms;
    return status;
}

/* One run's line: what it lacks. */
static sherf_status tell_run(experiment_job *j, const run *r, run_tally *t) {
    tell_state state = {t, 0};
    preset_time took;
    char path[PATH_LENGTH];
    const char *preset = r->method->preset[j->set.scale];
    sherf_status status = scorings_of(j, r, tell_scoring, &state);
    if (status == SHERF_OK) status = run_path(j, r, "finished.json", path);
    if (status != SHERF_OK) return status;
    const bool trains =
        !path_is_file(path) && first_time(j->c, t, path + strlen(j->options->output), &status);
    if (status != SHERF_OK || (!trains && !state.pictures)) return status;
    if ((status = preset_timed(j, preset, t, &took)) != SHERF_OK) return status;
    double training = 0;
    if (trains) status = training_hours(j, r, t, took.step_ms, &training);
    if (status != SHERF_OK) return status;
    const double scoring_hours = (double)state.pictures * took.frame_ms / 3.6e6;
    text_add(&t->text, "  %s on %s, seed %d:", preset, r->data->label, r->seed + 1);
    if (trains)
        text_add(&t->text, " training, %.2f h (a step of one picture takes %.0f ms);", training,
                 took.step_ms);
    text_add(&t->text, " scoring %" PRId64 " pictures, %.2f h (a frame takes %.0f ms)\n", state.pictures,
             scoring_hours, took.frame_ms);
    t->hours += training + scoring_hours;
    t->trainings += trains;
    return SHERF_OK;
}

sherf_status runs_tell(experiment_job *j, run_tally *t) {
    run r;
    sherf_status status = SHERF_OK;
    text_add(&t->text, "%s\n", j->experiment->name);
    for (int i = 0; status == SHERF_OK && run_at(j, i, &r); i++) status = tell_run(j, &r, t);
    return status;
}
