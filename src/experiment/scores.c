/* Reads scores.json, and computes people's means. */
#include "experiment/scores.h"

#include <string.h>

#include "io/value.h"

const score_metric score_metrics[METRICS] = {{"psnr", "PSNR", 2, 1},
                                             {"ssim", "SSIM", 3, 1},
                                             {"lpips", "LPIPS", 3, -1},
                                             {"resnet50", "resnet50", 3, -1},
                                             {"chamfer_cm", "Chamfer (cm)", 2, -1},
                                             {"to_truth_cm", "to the truth (cm)", 2, -1},
                                             {"from_truth_cm", "from it (cm)", 2, -1},
                                             {"normal_deg", "normals (degrees)", 1, -1},
                                             {"overlap", "IoU", 3, 1}};
static const char *const part_key[] = {"novel_view", "novel_pose"};

void scores_free(scores *s) {
    for (int i = 0; i < s->people && s->person; i++) mem_free(s->person[i].name);
    mem_free(s->person);
    mem_free(s->picture);
    *s = (scores){0};
}

/* NaN: there is none. */
static double number(const value *o, const char *key) {
    const value *v = o ? value_get(o, key) : NULL;
    if (v && v->kind == VALUE_REAL) return v->real;
    return v && v->kind == VALUE_INTEGER ? (double)v->integer : NAN;
}

static int whole(double v) {
    return v >= 0 && v < INT32_MAX ? (int)v : -1;
}

static void read_means(const value *o, double mean[SCORED_PARTS][METRICS]) {
    for (int k = 0; k < SCORED_PARTS; k++)
        for (int metric = 0; metric < METRICS; metric++)
            mean[k][metric] =
                k == SCORED_SURFACE ? NAN : number(value_get(o, part_key[k]), score_metrics[metric].key);
}

static int find_person(const scores *s, const value *name) {
    for (int i = 0; i < s->people; i++)
        if (value_is_string(name, s->person[i].name)) return i;
    return -1;
}

static sherf_status read_people(context *c, const value *list, scores *s) {
    const size_t n = value_count(list);
    if (n > INT32_MAX || !(s->person = mem_zero(c, n + 1, sizeof *s->person))) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        const value *o = value_at(list, i), *name = o ? value_get(o, "person") : NULL;
        if (!name || name->kind != VALUE_STRING) return failure(c, SHERF_BAD_FILE, "a person without a name");
        read_means(o, s->person[i].mean);
        if (!(s->person[i].name = mem_string(c, name->string.text))) return SHERF_NO_MEMORY;
        s->people++;
    }
    return SHERF_OK;
}

static sherf_status read_picture(context *c, const value *o, scores *s, picture_scores *to) {
    const value *seen = value_get(o, "observation"), *name = value_get(o, "person"),
                *kind = value_get(o, "kind");
    const value *pose = seen ? value_at(seen, 0) : NULL, *view = seen ? value_at(seen, 1) : NULL;
    *to = (picture_scores){
        .person = name ? find_person(s, name) : -1,
        .observed_pose = pose && pose->kind == VALUE_INTEGER ? whole((double)pose->integer) : -1,
        .observed_view = view && view->kind == VALUE_INTEGER ? whole((double)view->integer) : -1,
        .pose = whole(number(o, "pose")),
        .view = whole(number(o, "view")),
        .novel_pose = kind && value_is_string(kind, part_key[SCORED_POSE]),
        .psnr = number(o, "psnr")};
    if (to->person < 0 || to->observed_pose < 0 || to->observed_view < 0 || to->pose < 0 || to->view < 0)
        return failure(c, SHERF_BAD_FILE, "a picture without person, poses and views");
    return SHERF_OK;
}

static sherf_status read_pictures(context *c, const value *list, scores *s) {
    const size_t n = value_count(list);
    if (n > INT32_MAX || !(s->picture = mem_alloc(c, n + 1, sizeof *s->picture))) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        sherf_status status = read_picture(c, value_at(list, i), s, &s->picture[s->pictures]);
        if (status != SHERF_OK) return status;
        const picture_scores *k = &s->picture[s->pictures++];
        s->person[k->person].count[k->novel_pose ? SCORED_POSE : SCORED_VIEW]++;
    }
    return SHERF_OK;
}

static void read_estimates(const value *root, scores *s) {
    const value *all = value_get(root, "estimates");
    s->aligned_mm = NAN;
    if (!all) return;
    s->aligned_mm = number(value_get(all, "mean"), "aligned_mm");
    s->estimates = whole(number(all, "count"));
    s->missed = whole(number(all, "missed"));
}

/* Adds to sums, which read_surfaces turns into means. */
static sherf_status surface_take(context *c, const value *o, scores *s) {
    const value *name = o ? value_get(o, "person") : NULL;
    const int at = name ? find_person(s, name) : -1;
    if (at < 0) return failure(c, SHERF_BAD_FILE, "a surface without a person");
    double *sum = s->person[at].mean[SCORED_SURFACE];
    const bool first = !s->person[at].count[SCORED_SURFACE]++;
    for (int metric = PICTURE_METRICS; metric < METRICS; metric++) {
        const double v = number(o, score_metrics[metric].key);
        if (!isfinite(v))
            return failure(c, SHERF_BAD_FILE, "a surface without '%s'", score_metrics[metric].key);
        sum[metric] = first ? v : sum[metric] + v;
    }
    return SHERF_OK;
}

static sherf_status read_surfaces(context *c, const value *root, scores *s) {
    const value *all = value_get(root, "surfaces"), *each = all ? value_get(all, "each") : NULL;
    if (!all) return SHERF_OK;
    const size_t n = each && each->kind == VALUE_LIST ? value_count(each) : SIZE_MAX;
    s->surfaces_missed = whole(number(all, "missed"));
    if (n > INT32_MAX || s->surfaces_missed < 0)
        return failure(c, SHERF_BAD_FILE, "surfaces that were not compared one by one");
    for (size_t i = 0; i < n; i++) {
        const sherf_status status = surface_take(c, value_at(each, i), s);
        if (status != SHERF_OK) return status;
    }
    s->surfaces = (int)n;
    for (int i = 0; i < s->people; i++)
        for (int metric = PICTURE_METRICS; metric < METRICS && s->person[i].count[SCORED_SURFACE]; metric++)
            s->person[i].mean[SCORED_SURFACE][metric] /= s->person[i].count[SCORED_SURFACE];
    return SHERF_OK;
}

sherf_status scores_read(context *c, const char *path, scores *out) {
    document *d = NULL;
    *out = (scores){0};
    sherf_status status = json_read(c, path, &d);
    if (status != SHERF_OK) return status;
    const value *people = value_get(d->root, "people"), *images = value_get(d->root, "images");
    if (!people || !images || people->kind != VALUE_LIST || images->kind != VALUE_LIST) {
        status = failure(c, SHERF_BAD_FILE, "not the scores of an evaluation");
        goto done;
    }
    read_estimates(d->root, out);
    status = read_people(c, people, out);
    if (status == SHERF_OK) status = read_pictures(c, images, out);
    if (status == SHERF_OK) status = read_surfaces(c, d->root, out);
done:
    document_free(d);
    if (status != SHERF_OK) {
        failure_prefix(c, status, "%s", path);
        scores_free(out);
    }
    return status;
}

/* The mean over the scorings for one person, found by name. */
static double person_mean(const scores *of, int count, const char *name, scored_part part, int metric) {
    double sum = 0;
    int n = 0;
    for (int i = 0; i < count; i++)
        for (int k = 0; k < of[i].people; k++)
            if (!strcmp(of[i].person[k].name, name)) sum += of[i].person[k].mean[part][metric], n++;
    return n ? sum / n : NAN;
}

sherf_status scores_interval(context *c, const scores *of, const scores *minus, int count, scored_part part,
                             int metric, interval *out) {
    const int people = of->people;
    double *x = mem_alloc(c, (size_t)people + 1, 2 * sizeof *x), *weight = x + people;
    if (!x) return SHERF_NO_MEMORY;
    for (int i = 0; i < people; i++) {
        weight[i] = of->person[i].count[part];
        x[i] = person_mean(of, count, of->person[i].name, part, metric);
        if (minus) x[i] -= person_mean(minus, count, of->person[i].name, part, metric);
    }
    sherf_status status =
        interval_bootstrap(c, people, x, weight, random_key(1, "experiment.people", 0), out);
    mem_free(x);
    return status;
}
