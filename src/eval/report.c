/* Scores of pictures to means, a table and JSON. */
#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "eval/report.h"

sherf_status report_add(context *c, report *r, const report_entry *e) {
    if (r->count == r->capacity) {
        int64_t capacity = r->capacity ? 2 * r->capacity : 256;
        report_entry *grown = mem_grow(c, r->entry, (size_t)r->count, (size_t)capacity, sizeof *grown);
        if (!grown) return SHERF_NO_MEMORY;
        r->entry = grown;
        r->capacity = capacity;
    }
    r->entry[r->count++] = *e;
    return SHERF_OK;
}

void report_free(report *r) {
    for (int64_t i = 0; i < r->count; i++) {
        mem_free(r->entry[i].rgb);
        mem_free(r->entry[i].png);
    }
    mem_free(r->entry);
    estimate_list_free(&r->estimates);
    surface_list_free(&r->surfaces);
    *r = (report){0};
}

static bool belongs(const report_entry *e, int person, bool novel_pose) {
    return e->novel_pose == novel_pose && (person < 0 || e->person == person);
}

static void add_weighted(sherf_score *to, const sherf_score *from, double factor) {
    to->psnr += factor * from->psnr;
    to->ssim += factor * from->ssim;
    to->lpips += factor * from->lpips;
    to->resnet50 += factor * from->resnet50;
}

sherf_score report_mean(const report *r, int kind, int person, bool novel_pose) {
    sherf_score total = {0};
    int groups = 0, previous = -1;
    for (;;) { /* the next larger observation view */
        int view = INT32_MAX;
        sherf_score sum = {0};
        for (int64_t i = 0; i < r->count; i++) {
            const report_entry *e = &r->entry[i];
            const picture_score *p = &e->score[kind];
            int v = r->plain_mean ? 0 : e->observation.view;
            if (!belongs(e, person, novel_pose) || v <= previous || v > view) continue;
            if (v < view) {
                view = v;
                sum = (sherf_score){0};
            }
            add_weighted(
                &sum,
                &(sherf_score){.psnr = p->psnr, .ssim = p->ssim, .lpips = p->lpips, .resnet50 = p->resnet50},
                1);
            sum.count++;
        }
        if (!sum.count) break;
        add_weighted(&total, &sum, 1.0 / sum.count);
        total.count += sum.count;
        groups++;
        previous = view;
    }
    if (!groups) return (sherf_score){NAN, NAN, NAN, 0, NAN};
    sherf_score mean = {.count = total.count};
    add_weighted(&mean, &total, 1.0 / groups);
    return mean;
}

/* The model's gain over the better baseline in each number (the better one may differ between numbers).
 * Positive is better, also where smaller numbers are. */
static sherf_score report_gain(const report *r, int person, bool novel_pose) {
    const sherf_score mean = report_mean(r, SCORE_MODEL, person, novel_pose);
    const sherf_score a = report_mean(r, SCORE_MEAN_COLOR, person, novel_pose);
    const sherf_score b = report_mean(r, SCORE_PAINTED_BODY, person, novel_pose);
    return (sherf_score){.psnr = mean.psnr - fmax(a.psnr, b.psnr),
                         .ssim = mean.ssim - fmax(a.ssim, b.ssim),
                         .lpips = fmin(a.lpips, b.lpips) - mean.lpips,
                         .count = mean.count,
                         .resnet50 = fmin(a.resnet50, b.resnet50) - mean.resnet50};
}

/* The person after `previous` in the report, -1 at its end; `at` is the current position. */
static int next_person(const report *r, int64_t *at, int previous) {
    while (*at < r->count && r->entry[*at].person == previous) (*at)++;
    return *at < r->count ? r->entry[*at].person : -1;
}

/* The errors of one person, or of all (-1). Every pixel has the same weight, whichever picture it is in. */
static region_errors report_regions(const report *r, int person, bool novel_pose) {
    region_errors sum = {0};
    for (int64_t i = 0; i < r->count; i++)
        if (belongs(&r->entry[i], person, novel_pose)) regions_add(&sum, &r->entry[i].regions);
    return sum;
}

/* ---- table ---- */
static void number_text(double v, const char *format, char text[16]) {
    if (isnan(v))
        snprintf(text, 16, "-");
    else
        snprintf(text, 16, format, v);
}

/* "psnr ssim lpips resnet50 count"; differences have a sign. */
static void columns(sherf_score s, bool gain, char text[96]) {
    char t[4][16];
    number_text(s.psnr, gain ? "%+.3f" : "%.3f", t[0]);
    number_text(s.ssim, gain ? "%+.4f" : "%.4f", t[1]);
    number_text(s.lpips, gain ? "%+.4f" : "%.4f", t[2]);
    number_text(s.resnet50, gain ? "%+.4f" : "%.4f", t[3]);
    snprintf(text, 96, "%7s %7s %7s %8s %6d", t[0], t[1], t[2], t[3], s.count);
}

static size_t line(char *to, size_t room, int name_width, const char *name, bool gain,
                   const sherf_score s[2]) {
    char view[96], pose[96];
    columns(s[0], gain, view);
    columns(s[1], gain, pose);
    return (size_t)snprintf(to, room, "%-*.*s  %s    %s\n", name_width, name_width, name, view, pose);
}

/* The model, and the baselines below it. */
static size_t block(char *to, size_t room, int name_width, const char *name, const report *r, int person) {
    static const char *const baseline[SCORE_KINDS] = {"", "  mean colour", "  painted body"};
    size_t used = 0;
    for (int kind = 0; kind < (r->baselines ? SCORE_KINDS : 1); kind++)
        used +=
            line(to + used, room - used, name_width, kind ? baseline[kind] : name, false,
                 (sherf_score[]){report_mean(r, kind, person, false), report_mean(r, kind, person, true)});
    if (r->baselines)
        used += line(to + used, room - used, name_width, "  model's gain", true,
                     (sherf_score[]){report_gain(r, person, false), report_gain(r, person, true)});
    return used;
}

/* PSNR of what the observed pictures show of the people, of the rest, and of what limbs cover. */
static size_t region_lines(char *to, size_t room, int name_width, const report *r) {
    static const char *const name[REGIONS] = {"  seen", "  not seen", "  covered"};
    const region_errors view = report_regions(r, -1, false), pose = report_regions(r, -1, true);
    size_t used = 0;
    for (int i = 0; i < REGIONS; i++)
        used += line(to + used, room - used, name_width, name[i], false,
                     (sherf_score[]){{regions_psnr(&view, i), NAN, NAN, (int)view.pixels[i], NAN},
                                     {regions_psnr(&pose, i), NAN, NAN, (int)pose.pixels[i], NAN}});
    return used;
}

char *report_table(context *c, const report *r, const sherf_dataset *d) {
    enum { NAME_MAX_WIDTH = 40, LINE = 192, BLOCK = SCORE_KINDS + 1 };
    size_t lines = 2 + BLOCK + REGIONS;
    int width = r->baselines ? 14 : 10; /* the lines below the means */
    int64_t at = 0;
    for (int p = next_person(r, &at, -1); p >= 0; p = next_person(r, &at, p)) {
        int n = (int)strnlen(sherf_dataset_person(d, p), NAME_MAX_WIDTH);
        if (n > width) width = n;
        lines += BLOCK;
    }
    size_t room = lines * LINE, used = 0;
    char *text = mem_alloc(c, room, 1);
    if (!text) return NULL;
    used += (size_t)snprintf(text, room, "%-*s  %-39s    %s\n", width, "", "novel view", "novel pose");
    used += (size_t)snprintf(text + used, room - used, "%-*s  %7s %7s %7s %8s %6s    %7s %7s %7s %8s %6s\n",
                             width, "person", "PSNR", "SSIM", "LPIPS", "resnet50", "count", "PSNR", "SSIM",
                             "LPIPS", "resnet50", "count");
    at = 0;
    for (int p = next_person(r, &at, -1); p >= 0; p = next_person(r, &at, p))
        used += block(text + used, room - used, width, sherf_dataset_person(d, p), r, p);
    used += block(text + used, room - used, width, "mean", r, -1);
    region_lines(text + used, room - used, width, r);
    return text;
}

/* ---- JSON ---- */
static bool add_number(cJSON *to, const char *key, double v) {
    return (isfinite(v) ? cJSON_AddNumberToObject(to, key, v) : cJSON_AddNullToObject(to, key)) != NULL;
}

static bool add_score(cJSON *to, const char *key, sherf_score s) {
    cJSON *o = cJSON_AddObjectToObject(to, key);
    return o && add_number(o, "psnr", s.psnr) && add_number(o, "ssim", s.ssim) &&
           add_number(o, "lpips", s.lpips) && add_number(o, "resnet50", s.resnet50) &&
           add_number(o, "count", s.count);
}

static const char *const kind_key[SCORE_KINDS] = {NULL, "mean_color", "painted_body"};

static bool add_both(cJSON *to, const report *r, int kind, int person) {
    return add_score(to, "novel_view", report_mean(r, kind, person, false)) &&
           add_score(to, "novel_pose", report_mean(r, kind, person, true));
}

static bool add_regions(cJSON *to, const char *key, const region_errors *e) {
    static const char *const name[REGIONS] = {"seen", "not_seen", "covered"};
    cJSON *all = cJSON_AddObjectToObject(to, key);
    for (int i = 0; i < REGIONS && all; i++) {
        cJSON *o = cJSON_AddObjectToObject(all, name[i]);
        if (!o || !add_number(o, "psnr", regions_psnr(e, i)) ||
            !add_number(o, "pixels", (double)e->pixels[i]))
            return false;
    }
    return all != NULL;
}

/* Of one person, or of all. */
static bool add_means(cJSON *to, const report *r, int person) {
    const region_errors view = report_regions(r, person, false), pose = report_regions(r, person, true);
    bool ok = add_both(to, r, SCORE_MODEL, person);
    cJSON *regions = ok ? cJSON_AddObjectToObject(to, "regions") : NULL;
    ok = regions && add_regions(regions, "novel_view", &view) && add_regions(regions, "novel_pose", &pose);
    for (int kind = 1; kind < SCORE_KINDS && r->baselines && ok; kind++) {
        cJSON *o = cJSON_AddObjectToObject(to, kind_key[kind]);
        ok = o && add_both(o, r, kind, person);
    }
    if (!r->baselines || !ok) return ok;
    cJSON *o = cJSON_AddObjectToObject(to, "gain");
    return o && add_score(o, "novel_view", report_gain(r, person, false)) &&
           add_score(o, "novel_pose", report_gain(r, person, true));
}

static bool add_picture_score(cJSON *to, const picture_score *s) {
    return add_number(to, "psnr", s->psnr) && add_number(to, "ssim", s->ssim) &&
           add_number(to, "lpips", s->lpips) && add_number(to, "resnet50", s->resnet50);
}

static bool add_file(cJSON *to, const char *key, const char *name) {
    return (name ? cJSON_AddStringToObject(to, key, name) : cJSON_AddNullToObject(to, key)) != NULL;
}

static bool add_pair(cJSON *to, const char *key, picture p) {
    cJSON *pair = cJSON_CreateIntArray((int[]){p.pose, p.view}, 2);
    if (pair && cJSON_AddItemToObject(to, key, pair)) return true;
    cJSON_Delete(pair);
    return false;
}

static bool add_image(cJSON *images, const sherf_dataset *d, const report *r, const report_entry *e) {
    cJSON *o = cJSON_CreateObject();
    if (!o) return false;
    if (!cJSON_AddItemToArray(images, o)) {
        cJSON_Delete(o);
        return false;
    }
    if (!cJSON_AddStringToObject(o, "person", sherf_dataset_person(d, e->person)) ||
        !add_pair(o, "observation", e->observation))
        return false;
    for (int kind = 1; kind < SCORE_KINDS && r->baselines; kind++) {
        cJSON *baseline = cJSON_AddObjectToObject(o, kind_key[kind]);
        if (!baseline || !add_picture_score(baseline, &e->score[kind])) return false;
    }
    return add_number(o, "pose", e->target.pose) && add_number(o, "view", e->target.view) &&
           cJSON_AddStringToObject(o, "kind", e->novel_pose ? "novel_pose" : "novel_view") &&
           add_picture_score(o, &e->score[SCORE_MODEL]) && add_file(o, "rgb", e->rgb) &&
           add_file(o, "png", e->png);
}

static bool add_error(cJSON *to, const pose_error *e) {
    return add_number(to, "joints_mm", e->joints_mm) && add_number(to, "aligned_mm", e->aligned_mm) &&
           add_number(to, "lean_deg", e->lean_deg) && add_number(to, "forward_deg", e->forward_deg) &&
           add_number(to, "turn_deg", e->turn_deg) && add_number(to, "overlap", e->overlap);
}

/* A new entry of a list, with its observation; NULL: out of memory. */
static cJSON *add_observation(cJSON *list, const sherf_dataset *d, int person, picture observation) {
    cJSON *o = cJSON_CreateObject();
    if (!o || !cJSON_AddItemToArray(list, o)) {
        cJSON_Delete(o);
        return NULL;
    }
    const bool said = cJSON_AddStringToObject(o, "person", sherf_dataset_person(d, person)) &&
                      add_pair(o, "observation", observation);
    return said ? o : NULL;
}

/* What every estimate is off by, and their mean and the worst of each number. */
static bool add_estimates(cJSON *root, const estimate_list *l, const sherf_dataset *d) {
    cJSON *all = cJSON_AddObjectToObject(root, "estimates");
    cJSON *each = all ? cJSON_AddArrayToObject(all, "each") : NULL;
    for (int64_t i = 0; i < l->count && each; i++) {
        cJSON *o = add_observation(each, d, l->entry[i].person, l->entry[i].observation);
        if (!o || !add_error(o, &l->entry[i].error)) return false;
    }
    estimate_summary s = estimate_list_summary(l, -1);
    cJSON *mean = each ? cJSON_AddObjectToObject(all, "mean") : NULL;
    cJSON *worst = mean ? cJSON_AddObjectToObject(all, "worst") : NULL;
    return worst && add_error(mean, &s.mean) && add_error(worst, &s.worst) &&
           add_number(all, "wrong_way", s.wrong_way) && add_number(all, "count", s.count) &&
           add_number(all, "missed", l->missed);
}

static bool add_surface(cJSON *to, const surface_scores *s) {
    return add_number(to, "chamfer_cm", 100 * s->chamfer_m) &&
           add_number(to, "to_truth_cm", 100 * s->to_truth_m) &&
           add_number(to, "from_truth_cm", 100 * s->from_truth_m) &&
           add_number(to, "normal_deg", s->normal_deg) && add_number(to, "overlap", s->overlap);
}

/* Of every observation, and their mean. */
static bool add_surfaces(cJSON *root, const surface_list *l, const sherf_dataset *d) {
    int64_t count;
    const surface_scores mean = surface_list_mean(l, -1, &count);
    cJSON *all = cJSON_AddObjectToObject(root, "surfaces");
    cJSON *each = all ? cJSON_AddArrayToObject(all, "each") : NULL;
    for (int64_t i = 0; i < l->count && each; i++) {
        cJSON *o = add_observation(each, d, l->entry[i].person, l->entry[i].observation);
        if (!o || !add_surface(o, &l->entry[i].scores)) return false;
    }
    cJSON *o = each ? cJSON_AddObjectToObject(all, "mean") : NULL;
    return o && add_surface(o, &mean) && add_number(all, "count", (double)count) &&
           add_number(all, "missed", (double)l->missed);
}

static bool fill(cJSON *root, const report *r, const sherf_dataset *d) {
    if (r->pictures > 1 && !cJSON_AddNumberToObject(root, "pictures", r->pictures)) return false;
    if (r->variant && !cJSON_AddNumberToObject(root, "variant", (double)r->variant)) return false;
    cJSON *images = cJSON_AddArrayToObject(root, "images");
    if (!images) return false;
    for (int64_t i = 0; i < r->count; i++)
        if (!add_image(images, d, r, &r->entry[i])) return false;
    cJSON *people = cJSON_AddArrayToObject(root, "people");
    if (!people) return false;
    int64_t at = 0;
    for (int p = next_person(r, &at, -1); p >= 0; p = next_person(r, &at, p)) {
        cJSON *o = cJSON_CreateObject();
        if (!o) return false;
        if (!cJSON_AddItemToArray(people, o)) {
            cJSON_Delete(o);
            return false;
        }
        if (!cJSON_AddStringToObject(o, "person", sherf_dataset_person(d, p)) || !add_means(o, r, p))
            return false;
    }
    if ((r->estimates.count || r->estimates.missed) && !add_estimates(root, &r->estimates, d)) return false;
    if ((r->surfaces.count || r->surfaces.missed) && !add_surfaces(root, &r->surfaces, d)) return false;
    return add_means(root, r, -1);
}

sherf_status report_write_json(context *c, const report *r, const sherf_dataset *d, const char *path) {
    sherf_status status = SHERF_OK;
    output_file out = {0};
    char *text = NULL;
    cJSON *root = cJSON_CreateObject();
    if (!root || !fill(root, r, d) || !(text = cJSON_Print(root))) {
        status = failure(c, SHERF_NO_MEMORY, "out of memory: the scores");
        goto done;
    }
    if ((status = output_open(c, path, &out)) != SHERF_OK) goto done;
    if ((status = output_write(c, &out, text, strlen(text))) != SHERF_OK) goto done;
    if ((status = output_write(c, &out, "\n", 1)) != SHERF_OK) goto done;
    status = output_commit(c, &out);
done:
    output_abort(&out);
    cJSON_free(text);
    cJSON_Delete(root);
    return status;
}
