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
    *r = (report){0};
}

static bool belongs(const report_entry *e, int person, bool novel_pose) {
    return e->novel_pose == novel_pose && (person < 0 || e->person == person);
}

sherf_score report_mean(const report *r, int person, bool novel_pose) {
    sherf_score total = {0};
    int groups = 0, previous = -1;
    for (;;) { /* the next larger observation view */
        int view = INT32_MAX;
        sherf_score sum = {0};
        for (int64_t i = 0; i < r->count; i++) {
            const report_entry *e = &r->entry[i];
            int v = e->observation.view;
            if (!belongs(e, person, novel_pose) || v <= previous || v > view) continue;
            if (v < view) {
                view = v;
                sum = (sherf_score){0};
            }
            sum.psnr += e->psnr, sum.ssim += e->ssim, sum.lpips += e->lpips;
            sum.count++;
        }
        if (!sum.count) break;
        total.psnr += sum.psnr / sum.count;
        total.ssim += sum.ssim / sum.count;
        total.lpips += sum.lpips / sum.count;
        total.count += sum.count;
        groups++;
        previous = view;
    }
    if (!groups) return (sherf_score){NAN, NAN, NAN, 0};
    return (sherf_score){total.psnr / groups, total.ssim / groups, total.lpips / groups, total.count};
}

/* The person after `previous` in the report, -1 at its end; `at` is where the walk stands. */
static int next_person(const report *r, int64_t *at, int previous) {
    while (*at < r->count && r->entry[*at].person == previous) (*at)++;
    return *at < r->count ? r->entry[*at].person : -1;
}

/* ---- table ---- */
static void number_text(double v, const char *format, char text[16]) {
    if (isnan(v))
        snprintf(text, 16, "-");
    else
        snprintf(text, 16, format, v);
}

static int line(char *to, size_t room, int name_width, const char *name, sherf_score view, sherf_score pose) {
    char t[6][16];
    number_text(view.psnr, "%.3f", t[0]);
    number_text(view.ssim, "%.4f", t[1]);
    number_text(view.lpips, "%.4f", t[2]);
    number_text(pose.psnr, "%.3f", t[3]);
    number_text(pose.ssim, "%.4f", t[4]);
    number_text(pose.lpips, "%.4f", t[5]);
    return snprintf(to, room, "%-*.*s  %7s %7s %7s %6d    %7s %7s %7s %6d\n", name_width, name_width, name,
                    t[0], t[1], t[2], view.count, t[3], t[4], t[5], pose.count);
}

char *report_table(context *c, const report *r, const sherf_dataset *d) {
    enum { NAME_MAX_WIDTH = 40, LINE = 160 };
    size_t lines = 3;
    int width = 6;
    int64_t at = 0;
    for (int p = next_person(r, &at, -1); p >= 0; p = next_person(r, &at, p)) {
        int n = (int)strnlen(sherf_dataset_person(d, p), NAME_MAX_WIDTH);
        if (n > width) width = n;
        lines++;
    }
    size_t room = lines * LINE, used = 0;
    char *text = mem_alloc(c, room, 1);
    if (!text) return NULL;
    used += (size_t)snprintf(text, room, "%-*s  %-33s  %s\n", width, "", "novel view", "novel pose");
    used += (size_t)snprintf(text + used, room - used, "%-*s  %7s %7s %7s %6s    %7s %7s %7s %6s\n", width,
                             "person", "PSNR", "SSIM", "LPIPS", "count", "PSNR", "SSIM", "LPIPS", "count");
    at = 0;
    for (int p = next_person(r, &at, -1); p >= 0; p = next_person(r, &at, p))
        used += (size_t)line(text + used, room - used, width, sherf_dataset_person(d, p),
                             report_mean(r, p, false), report_mean(r, p, true));
    line(text + used, room - used, width, "mean", report_mean(r, -1, false), report_mean(r, -1, true));
    return text;
}

/* ---- JSON ---- */
static bool add_number(cJSON *to, const char *key, double v) {
    return (isfinite(v) ? cJSON_AddNumberToObject(to, key, v) : cJSON_AddNullToObject(to, key)) != NULL;
}

static bool add_score(cJSON *to, const char *key, sherf_score s) {
    cJSON *o = cJSON_AddObjectToObject(to, key);
    return o && add_number(o, "psnr", s.psnr) && add_number(o, "ssim", s.ssim) &&
           add_number(o, "lpips", s.lpips) && add_number(o, "count", s.count);
}

static bool add_file(cJSON *to, const char *key, const char *name) {
    return (name ? cJSON_AddStringToObject(to, key, name) : cJSON_AddNullToObject(to, key)) != NULL;
}

static bool add_image(cJSON *images, const sherf_dataset *d, const report_entry *e) {
    cJSON *o = cJSON_CreateObject();
    if (!o) return false;
    if (!cJSON_AddItemToArray(images, o)) {
        cJSON_Delete(o);
        return false;
    }
    cJSON *pair = NULL;
    if (!cJSON_AddStringToObject(o, "person", sherf_dataset_person(d, e->person))) return false;
    if (!(pair = cJSON_CreateIntArray((int[]){e->observation.pose, e->observation.view}, 2))) return false;
    if (!cJSON_AddItemToObject(o, "observation", pair)) {
        cJSON_Delete(pair);
        return false;
    }
    return add_number(o, "pose", e->target.pose) && add_number(o, "view", e->target.view) &&
           cJSON_AddStringToObject(o, "kind", e->novel_pose ? "novel_pose" : "novel_view") &&
           add_number(o, "psnr", e->psnr) && add_number(o, "ssim", e->ssim) &&
           add_number(o, "lpips", e->lpips) && add_file(o, "rgb", e->rgb) && add_file(o, "png", e->png);
}

static bool fill(cJSON *root, const report *r, const sherf_dataset *d) {
    cJSON *images = cJSON_AddArrayToObject(root, "images");
    if (!images) return false;
    for (int64_t i = 0; i < r->count; i++)
        if (!add_image(images, d, &r->entry[i])) return false;
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
        if (!cJSON_AddStringToObject(o, "person", sherf_dataset_person(d, p)) ||
            !add_score(o, "novel_view", report_mean(r, p, false)) ||
            !add_score(o, "novel_pose", report_mean(r, p, true)))
            return false;
    }
    return add_score(root, "novel_view", report_mean(r, -1, false)) &&
           add_score(root, "novel_pose", report_mean(r, -1, true));
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
