/* Trains and scores an experiment's runs (runs.c); each finished scoring is a file. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "eval/protocol.h"
#include "experiment/disturb.h"
#include "experiment/experiment.h"

/* ---- scorings ---- */
/* The bodies of some test people in their first observed pose. */
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
                                  .write_png = s->kind == SCORING_STUDY,
                                  .surfaces = s->kind == SCORING_SURFACE,
                                  .estimated = s->kind == SCORING_ESTIMATED ? j->options->estimator : NULL};
    run_tell(j, r, looks ? "pictures to look at" : "scoring");
    const double begun = time_seconds();
    status = evaluate(j, d, s, &o);
    if (status != SHERF_OK) return status;
    j->pictures_left -= k->pictures;
    j->picture_s = (time_seconds() - begun) / (double)k->pictures;
    return SHERF_OK;
}

sherf_status run_scorings(experiment_job *j, const run *r, scoring_function *once, void *arg) {
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
/* For given data sets only; made people get their surfaces. */
static const char *surfaces_lack(experiment_job *j) {
    for (int i = 0; i < j->data_count; i++) {
        if (j->data[i].made || !data_is_trained_on(j, i)) continue;
        if (data_has_surfaces(j, &j->data[i]) == SHERF_OK) continue;
        snprintf(j->lack, sizeof j->lack, "people's surfaces: %s", j->c->message);
        return j->lack;
    }
    return NULL;
}

const char *experiment_lack(experiment_job *j) {
    const experiment *e = j->experiment;
    for (int i = 0; i < e->scorings; i++) {
        if (e->scoring[i].kind == SCORING_ESTIMATED && !j->options->estimator)
            return "the networks that see people in photos";
        if (e->scoring[i].crossed && j->data_count < 2) return "two data sets";
    }
    return e->surfaces ? surfaces_lack(j) : NULL;
}

static sherf_status data_ready(experiment_job *j) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < j->data_count && status == SHERF_OK; i++)
        if (data_is_trained_on(j, i)) status = data_make(j, &j->data[i]);
    return status;
}

static sherf_status count_left(experiment_job *j) {
    run r;
    char path[PATH_LENGTH];
    j->trainings_left = 0;
    j->pictures_left = 0;
    for (int i = 0; run_at(j, i, &r); i++) {
        sherf_status status = run_path(j, &r, "finished.json", path);
        if (status == SHERF_OK) status = run_scorings(j, &r, count_once, NULL);
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
    if (status == SHERF_OK) status = steps_ready(j);
    if (status == SHERF_OK) status = count_left(j);
    for (int i = 0; status == SHERF_OK && run_at(j, i, &r); i++) {
        status = training_do(j, &r);
        if (status == SHERF_OK) status = run_scorings(j, &r, score_once, NULL);
    }
    return status;
}
