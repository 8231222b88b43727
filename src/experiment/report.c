/* Scores as tables, with a row for each method, next to the paper's numbers. */
#include <stdio.h>
#include <string.h>

#include "experiment/experiment.h"

void scores_free_all(scores *s, int count) {
    for (int i = 0; i < count; i++) scores_free(&s[i]);
}

sherf_status report_read(experiment_job *j, const experiment_method *method, const experiment_data *data,
                         const scoring *s, int pose, scores out[SEEDS_MAX], int *count) {
    const int seeds = j->experiment->all_seeds ? j->set.seeds : 1;
    sherf_status status = SHERF_OK;
    *count = 0;
    for (int i = 0; i < seeds && status == SHERF_OK; i++) {
        const run r = {method, data, i};
        char path[PATH_LENGTH];
        status = scoring_path(j, &r, s, pose, "scores.json", path);
        if (status == SHERF_OK) status = scores_read(j->c, path, &out[i]);
        if (status == SHERF_OK) (*count)++;
    }
    if (status != SHERF_OK) scores_free_all(out, *count);
    return status;
}

/* ---- tables of scores ---- */
/* A column group of a table: a scoring and the part of its scores. */
typedef struct {
    const char *label;
    scoring scoring;
    scored_part part;
} score_group;
enum { GROUPS_MAX = 4 };
typedef struct {
    const score_group *group;
    int groups;
    bool metric[METRICS]; /* the known ones; a group has those of pictures or those of surfaces */
} score_layout;

static const score_group by_protocol[] = {{"novel view", {SCORING_PROTOCOL}, SCORED_VIEW},
                                          {"novel pose", {SCORING_PROTOCOL}, SCORED_POSE}};

/* The metrics that were computed depend on which networks were present. */
static void metrics_known(const experiment_job *j, score_layout *l) {
    l->metric[METRIC_PSNR] = l->metric[METRIC_SSIM] = true;
    l->metric[METRIC_LPIPS] = j->options->lpips != NULL;
    l->metric[METRIC_RESNET50] = j->options->perceptual != NULL;
    for (int metric = PICTURE_METRICS; metric < METRICS; metric++) l->metric[metric] = true;
}

static bool group_has(const score_layout *l, const score_group *g, int metric) {
    return l->metric[metric] && (metric >= PICTURE_METRICS) == (g->part == SCORED_SURFACE);
}

static sherf_status columns_add(context *c, const score_layout *l, page_table *t) {
    sherf_status status = SHERF_OK;
    for (int g = 0; g < l->groups; g++)
        for (int metric = 0; metric < METRICS && status == SHERF_OK; metric++)
            if (group_has(l, &l->group[g], metric))
                status = page_add_column(c, t, l->group[g].label, score_metrics[metric].label,
                                         score_metrics[metric].decimals, score_metrics[metric].better);
    return status;
}

/* Fills in a method's values, or its differences from another's. */
static sherf_status row_fill(experiment_job *j, const score_layout *l, const experiment_method *method,
                             const experiment_method *minus, const experiment_data *data, page_row *row) {
    scores of[SEEDS_MAX], other[SEEDS_MAX];
    int count, others = 0, column = 0;
    sherf_status status = SHERF_OK;
    for (int g = 0; g < l->groups && status == SHERF_OK; g++) {
        const score_group *k = &l->group[g];
        status = report_read(j, method, data, &k->scoring, 0, of, &count);
        if (status != SHERF_OK) return status;
        if (minus) status = report_read(j, minus, data, &k->scoring, 0, other, &others);
        for (int i = 0; i < METRICS && status == SHERF_OK; i++)
            if (group_has(l, k, i))
                status =
                    scores_interval(j->c, of, minus ? other : NULL, count, k->part, i, &row->value[column++]);
        scores_free_all(of, count);
        scores_free_all(other, others);
        others = 0;
    }
    return status;
}

static const experiment_method *method_at(const experiment_job *j, int i) {
    const experiment_method *method = i < EXPERIMENT_METHODS && j->experiment->method[i]
                                          ? experiment_method_find(j->experiment->method[i])
                                          : NULL;
    return method && method->on_request && !j->options->own ? NULL : method;
}

static int methods_of(const experiment_job *j) {
    int n = 0;
    while (method_at(j, n)) n++;
    return n;
}

static const experiment_method *subject_of(const experiment_job *j) {
    for (int i = 0; method_at(j, i); i++)
        if (!strcmp(method_at(j, i)->label, "SHERF")) return method_at(j, i);
    return NULL;
}

static sherf_status scores_table(experiment_job *j, page *p, const score_layout *l,
                                 const experiment_data *data, const char *title) {
    page_table *t = page_add_table(j->c, p, "%s", title);
    sherf_status status = t ? columns_add(j->c, l, t) : SHERF_NO_MEMORY;
    for (int i = 0; i < methods_of(j) && status == SHERF_OK; i++) {
        page_row *row = page_add_row(j->c, t, "%s", method_at(j, i)->label);
        status = row ? row_fill(j, l, method_at(j, i), NULL, data, row) : SHERF_NO_MEMORY;
    }
    return status;
}

/* SHERF's difference to each other method; the interval shows whether the order holds. */
static sherf_status differences_table(experiment_job *j, page *p, const score_layout *l,
                                      const experiment_data *data, const char *title) {
    const experiment_method *subject = subject_of(j);
    if (!subject || methods_of(j) < 2) return SHERF_OK;
    page_table *t = page_add_table(j->c, p, "SHERF less another method, %s", title);
    sherf_status status = t ? columns_add(j->c, l, t) : SHERF_NO_MEMORY;
    for (int k = 0; t && k < t->columns; k++) t->column[k].better = 0;
    for (int i = 0; i < methods_of(j) && status == SHERF_OK; i++) {
        if (method_at(j, i) == subject) continue;
        page_row *row = page_add_row(j->c, t, "SHERF - %s", method_at(j, i)->label);
        status = row ? row_fill(j, l, subject, method_at(j, i), data, row) : SHERF_NO_MEMORY;
    }
    return status;
}

/* ---- how they were trained ---- */
static sherf_status facts_row(experiment_job *j, const run *r, page_table *t) {
    training_facts f;
    sherf_status status = training_read(j, r, &f);
    if (status != SHERF_OK) return status;
    page_row *row = page_add_row(j->c, t, "%s on %s, seed %d", r->method->label, r->data->label, r->seed + 1);
    if (!row) return SHERF_NO_MEMORY;
    const double fact[] = {f.weights / 1e6, f.steps, f.pictures, f.minutes, f.step_ms};
    for (size_t k = 0; k < COUNT_OF(fact); k++) row->value[k] = interval_of(fact[k]);
    return SHERF_OK;
}

static sherf_status facts_table(experiment_job *j, page *p) {
    static const char *const name[] = {"million weights", "steps", "pictures", "minutes", "ms a step"};
    page_table *t = page_add_table(j->c, p, "Trainings");
    sherf_status status = t ? SHERF_OK : SHERF_NO_MEMORY;
    run r;
    for (size_t k = 0; k < COUNT_OF(name) && status == SHERF_OK; k++)
        status = page_add_column(j->c, t, "", name[k], k ? k < 3 ? 0 : 1 : 2, 0);
    for (int i = 0; status == SHERF_OK && run_at(j, i, &r); i++) status = facts_row(j, &r, t);
    return status;
}

static sherf_status notes_add(experiment_job *j, page *p) {
    sherf_status status =
        page_add_note(j->c, p,
                      "In brackets: 95 %% intervals of a bootstrap over the test people; of several seeds a "
                      "person's value is the "
                      "mean. The seeds' trainings draw other first weights and pictures in another order.");
    if (status == SHERF_OK && j->experiment->note) status = page_add_note(j->c, p, "%s", j->experiment->note);
    if (status == SHERF_OK && j->data[0].made)
        status = page_add_note(
            j->c, p,
            "The people are made ones (docs/people.md). Numbers of the paper are of real ones: the "
            "order of rows may be compared with them, numbers may not.");
    if (status == SHERF_OK && !j->options->lpips)
        status =
            page_add_note(j->c, p, "LPIPS's weights were not given, so it is not computed%s.",
                          j->options->perceptual ? "; resnet50 is another distance (docs/training.md)" : "");
    return status;
}

sherf_status report_end(experiment_job *j, page *p) {
    sherf_status status = published_add(j->c, p, j->experiment->name);
    if (status == SHERF_OK) status = facts_table(j, p);
    if (status == SHERF_OK) status = gallery_add(j, p);
    return status == SHERF_OK ? notes_add(j, p) : status;
}

/* ---- experiments ---- */
sherf_status report_scores(experiment_job *j, page *p) {
    score_layout l = {by_protocol, COUNT_OF(by_protocol), {0}};
    sherf_status status = SHERF_OK;
    metrics_known(j, &l);
    for (int d = 0; d < j->data_count && status == SHERF_OK; d++) {
        if (j->data[d].only_crossed || (d && !j->experiment->all_data)) continue;
        status = scores_table(j, p, &l, &j->data[d], j->data[d].label);
        if (status == SHERF_OK) status = differences_table(j, p, &l, &j->data[d], j->data[d].label);
    }
    return status == SHERF_OK ? report_end(j, p) : status;
}

/* Notes how many surfaces were compared, and how many observations gave none. */
static sherf_status surfaces_note(experiment_job *j, page *p) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < methods_of(j) && status == SHERF_OK; i++) {
        scores of[SEEDS_MAX];
        int count;
        status = report_read(j, method_at(j, i), &j->data[0], &(scoring){SCORING_SURFACE}, 0, of, &count);
        if (status == SHERF_OK && of->surfaces + of->surfaces_missed)
            status = page_add_note(j->c, p,
                                   "%s: surfaces of %d observations are compared with the truth's "
                                   "(docs/evaluation.md, Surfaces); of %d none came out.",
                                   method_at(j, i)->label, of->surfaces, of->surfaces_missed);
        scores_free_all(of, count);
    }
    return status;
}

sherf_status report_pifu(experiment_job *j, page *p) {
    static const score_group group[] = {{"novel view", {SCORING_PROTOCOL}, SCORED_VIEW},
                                        {"surface", {SCORING_SURFACE}, SCORED_SURFACE}};
    score_layout l = {group, COUNT_OF(group), {0}}, pictures = {group, 1, {0}};
    metrics_known(j, &l);
    metrics_known(j, &pictures);
    sherf_status status = scores_table(j, p, &l, &j->data[0], j->data[0].label);
    if (status == SHERF_OK) status = differences_table(j, p, &pictures, &j->data[0], j->data[0].label);
    if (status == SHERF_OK) status = surfaces_note(j, p);
    return status == SHERF_OK ? report_end(j, p) : status;
}

sherf_status report_front(experiment_job *j, page *p) {
    static const score_group group[] = {{"from the front: view", {SCORING_FRONT}, SCORED_VIEW},
                                        {"from the front: pose", {SCORING_FRONT}, SCORED_POSE},
                                        {"freely: view", {SCORING_PROTOCOL}, SCORED_VIEW},
                                        {"freely: pose", {SCORING_PROTOCOL}, SCORED_POSE}};
    score_layout l = {group, COUNT_OF(group), {0}};
    metrics_known(j, &l);
    sherf_status status = scores_table(j, p, &l, &j->data[0], "Trained on front views, observed");
    if (status == SHERF_OK) status = differences_table(j, p, &l, &j->data[0], "trained on front views");
    return status == SHERF_OK ? report_end(j, p) : status;
}

sherf_status report_cross(experiment_job *j, page *p) {
    static const score_group group[] = {{"novel view", {SCORING_PROTOCOL, .crossed = true}, SCORED_VIEW},
                                        {"novel pose", {SCORING_PROTOCOL, .crossed = true}, SCORED_POSE}};
    score_layout l = {group, COUNT_OF(group), {0}};
    sherf_status status = SHERF_OK;
    metrics_known(j, &l);
    for (int d = 0; d < 2 && status == SHERF_OK; d++) {
        char title[200];
        snprintf(title, sizeof title, "trained on %s, tested on %s", j->data[d].label, j->data[1 - d].label);
        status = scores_table(j, p, &l, &j->data[d], title);
        if (status == SHERF_OK) status = differences_table(j, p, &l, &j->data[d], title);
    }
    return status == SHERF_OK ? report_end(j, p) : status;
}

/* ---- estimated bodies ---- */
/* A method's PSNR as a function of the bodies' error, as its scorings measured it. */
static sherf_status disturbed_line(experiment_job *j, const experiment_method *method, scored_part part,
                                   page_plot *plot) {
    page_series *line = page_add_series(j->c, plot, method->label);
    sherf_status status = line ? SHERF_OK : SHERF_NO_MEMORY;
    for (int i = 0; i < j->experiment->scorings && status == SHERF_OK; i++) {
        const scoring *s = &j->experiment->scoring[i];
        scores of[SEEDS_MAX];
        interval v;
        int count;
        if (s->kind == SCORING_ESTIMATED) continue;
        if ((status = report_read(j, method, &j->data[0], s, 0, of, &count)) != SHERF_OK) break;
        status = scores_interval(j->c, of, NULL, count, part, METRIC_PSNR, &v);
        if (status == SHERF_OK)
            status = page_add_point(j->c, line, s->kind == SCORING_PROTOCOL ? 0 : of->aligned_mm, v);
        scores_free_all(of, count);
    }
    return status;
}

static sherf_status disturbed_plots(experiment_job *j, page *p) {
    sherf_status status = SHERF_OK;
    for (int pose = 0; pose < 2 && status == SHERF_OK; pose++) {
        page_plot *plot = page_add_plot(j->c, p, pose ? "disturbed-pose" : "disturbed-view",
                                        pose ? "novel pose" : "novel view");
        if (!plot) return SHERF_NO_MEMORY;
        snprintf(plot->x, sizeof plot->x, "joints off after Procrustes (mm)");
        snprintf(plot->y, sizeof plot->y, "PSNR (dB)");
        for (int i = 0; i < methods_of(j) && status == SHERF_OK; i++)
            status = disturbed_line(j, method_at(j, i), pose ? SCORED_POSE : SCORED_VIEW, plot);
    }
    return status;
}

static sherf_status estimates_note(experiment_job *j, page *p) {
    scores of[SEEDS_MAX];
    int count;
    sherf_status status =
        report_read(j, method_at(j, 0), &j->data[0], &(scoring){SCORING_ESTIMATED}, 0, of, &count);
    if (status != SHERF_OK) return status;
    status = page_add_note(
        j->c, p,
        "Estimates are this program's own (docs/photo.md) in place of CLIFF's: %d bodies, off by %.0f "
        "mm after Procrustes; nobody was found in %d pictures.",
        of->estimates, of->aligned_mm, of->missed);
    scores_free_all(of, count);
    if (status != SHERF_OK) return status;
    return page_add_note(
        j->c, p,
        "The plots' bodies are true ones disturbed: noise in all joints' angles, a third of it in the "
        "root's, in the shape, and up to 5 %% of the distance; camera and mask stay true.");
}

sherf_status report_estimated(experiment_job *j, page *p) {
    static const score_group group[] = {{"true: view", {SCORING_PROTOCOL}, SCORED_VIEW},
                                        {"true: pose", {SCORING_PROTOCOL}, SCORED_POSE},
                                        {"estimated: view", {SCORING_ESTIMATED}, SCORED_VIEW},
                                        {"estimated: pose", {SCORING_ESTIMATED}, SCORED_POSE}};
    score_layout l = {group, COUNT_OF(group), {0}};
    metrics_known(j, &l);
    sherf_status status = scores_table(j, p, &l, &j->data[0], "Bodies and cameras");
    if (status == SHERF_OK) status = differences_table(j, p, &l, &j->data[0], "by bodies and cameras");
    if (status == SHERF_OK) status = disturbed_plots(j, p);
    if (status == SHERF_OK) status = estimates_note(j, p);
    return status == SHERF_OK ? report_end(j, p) : status;
}
