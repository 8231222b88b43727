/* The runs of an experiment, and the paths of their files and scorings. */
#include <math.h>
#include <stdio.h>

#include "experiment/experiment.h"

sherf_status job_path(const experiment_job *j, char out[PATH_LENGTH], const char *format, ...) {
    va_list args;
    int n = snprintf(out, PATH_LENGTH, "%s/", j->options->output);
    va_start(args, format);
    if (n < PATH_LENGTH) n += vsnprintf(out + n, (size_t)(PATH_LENGTH - n), format, args);
    va_end(args);
    if (n < PATH_LENGTH) return SHERF_OK;
    return failure(j->c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", j->options->output);
}

bool data_is_trained_on(const experiment_job *j, int i) {
    const experiment *e = j->experiment;
    if (e->all_data) return !j->data[i].only_crossed;
    return i == 0 || (e->both_ways && i == 1);
}

bool run_at(const experiment_job *j, int i, run *out) {
    const experiment *e = j->experiment;
    const int seeds = e->all_seeds ? j->set.seeds : 1;
    for (int d = 0; d < j->data_count; d++)
        for (int k = 0; k < EXPERIMENT_METHODS && e->method[k] && data_is_trained_on(j, d); k++) {
            const experiment_method *method = experiment_method_find(e->method[k]);
            if (method->on_request && !j->options->own) continue;
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
    static const char *const kind[SCORING_KINDS] = {"protocol", "front", "angles", "estimated", "disturbed",
                                                    "views",    "poses", "study",  "surface"};
    char part[200];
    size_t n = (size_t)snprintf(part, sizeof part, "scores/%s", kind[s->kind]);
    if (s->level) n += (size_t)snprintf(part + n, sizeof part - n, "-%d", s->level);
    if (s->crossed) n += (size_t)snprintf(part + n, sizeof part - n, "-on-%s", scoring_data(j, r, s)->key);
    if (s->kind == SCORING_ANGLES) n += (size_t)snprintf(part + n, sizeof part - n, "-%d", pose);
    snprintf(part + n, sizeof part - n, "/%s", name);
    return run_path(j, r, part, out);
}

void run_tell(experiment_job *j, const run *r, const char *what) {
    const double left = j->trainings_left * j->training_s + (double)j->pictures_left * j->picture_s;
    log_line(j->c, SHERF_LOG_INFO, "%s: %s on %s, seed %d: %s (about %.0f min left)", j->experiment->name,
             r->method->label, r->data->label, r->seed + 1, what, ceil(left / 60));
}
