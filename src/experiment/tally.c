/* Dry runs: what an experiment lacks, and how long that takes. */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "experiment/experiment.h"
#include "io/value.h"

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

/* The milliseconds, measured as by `sherf bench`. */
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

/* Times a preset once, as long as there is room to remember it. */
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

/* If this method takes its number of steps from another one, that method's minutes count. */
static sherf_status training_hours(experiment_job *j, const run *r, run_tally *t, double step_ms,
                                   double *hours) {
    const experiment_settings *s = &j->set;
    int pictures;
    sherf_status status = training_step_pictures(j, r->method, &pictures);
    if (status != SHERF_OK) return status;
    *hours = s->minutes > 0 ? s->minutes / 60 : (double)s->steps * pictures * step_ms / 3.6e6;
    if (!(s->minutes > 0) || !r->method->steps_of) return SHERF_OK;
    preset_time of;
    status = preset_timed(j, experiment_method_find(r->method->steps_of)->preset[s->scale], t, &of);
    *hours *= step_ms / of.step_ms;
    return status;
}

/* Writes a line about what one run lacks. */
static sherf_status tell_run(experiment_job *j, const run *r, run_tally *t) {
    tell_state state = {t, 0};
    preset_time took;
    char path[PATH_LENGTH];
    const char *preset = r->method->preset[j->set.scale];
    sherf_status status = run_scorings(j, r, tell_scoring, &state);
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
    text_add(&t->text, "  %s (%s) on %s, seed %d:", r->method->label, preset, r->data->label, r->seed + 1);
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
