/* sherf_experiment: a folder's settings, and its experiments in order. */
#include <cjson/cJSON.h>
#include <stdio.h>
#include <string.h>

#include "experiment/experiment.h"
#include "train/adam.h"

const char *sherf_experiment_name(int i) {
    const experiment *e = experiment_at(i);
    return e ? e->name : NULL;
}

/* ---- settings ---- */
/* The paper's settings are the release's: the rate is halved every 16,000 pictures, and nothing changes any
 * more after 200,000; beta2 is 0.99^0.8. */
static const experiment_settings scale[SCALES] = {[SCALE_SMOKE] = {.size_px = 48,
                                                                   .people = 4,
                                                                   .train_poses = 2,
                                                                   .train_views = 4,
                                                                   .test_poses = 2,
                                                                   .seeds = 2,
                                                                   .batch = 1,
                                                                   .targets = 2,
                                                                   .steps = 2},
                                                  [SCALE_QUICK] = {.size_px = 128,
                                                                   .people = 100,
                                                                   .train_poses = 4,
                                                                   .train_views = 8,
                                                                   .test_poses = 3,
                                                                   .seeds = 3,
                                                                   .batch = 1,
                                                                   .targets = 4,
                                                                   .minutes = 12},
                                                  [SCALE_PAPER] = {.people = 500,
                                                                   .train_poses = 6,
                                                                   .train_views = 24,
                                                                   .test_poses = 5,
                                                                   .seeds = 1,
                                                                   .batch = 4,
                                                                   .targets = 1,
                                                                   .steps = 50000,
                                                                   .halve_pictures = 16000,
                                                                   .beta2 = 0.992}};
static const char *const scale_name[SCALES] = {"smoke", "quick", "paper"};
enum { PEOPLE_MAX = 100000, MADE_PAPER_PX = 512 };

/* SCALES: no scale has that name. */
static experiment_scale scale_of(const char *name) {
    int i = 0;
    if (!name) return SCALE_QUICK;
    while (i < SCALES && strcmp(scale_name[i], name)) i++;
    return (experiment_scale)i;
}

static sherf_status options_check(context *c, const sherf_experiment_options *o) {
    if (!o || !o->output || !*o->output) return failure(c, SHERF_BAD_ARGUMENT, "an output folder is needed");
    if (scale_of(o->preset) == SCALES)
        return failure(c, SHERF_BAD_ARGUMENT, "preset '%.60s': should be smoke, quick or paper", o->preset);
    if (o->size_px < 0 || (o->size_px && o->size_px < 16) || o->size_px > 4096 || o->people < 0 ||
        o->people == 1 || o->people > PEOPLE_MAX || o->seeds < 0 || o->seeds > SEEDS_MAX ||
        !(o->minutes >= 0 && o->minutes <= 1e6) || o->steps < 0 || o->steps > (int64_t)1 << 40)
        return failure(c, SHERF_BAD_ARGUMENT, "an option of the experiment is out of range");
    if (o->minutes > 0 && o->steps)
        return failure(c, SHERF_BAD_ARGUMENT, "a training is so many minutes or so many steps, not both");
    if (o->data_count && o->people)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "the number of people is that of made ones: name those of a data set");
    if (!o->data_count && (o->train_people || o->test_people))
        return failure(c, SHERF_BAD_ARGUMENT, "people are named of a data set: made ones are counted");
    return SHERF_OK;
}

static void settings_take(const sherf_experiment_options *o, experiment_settings *s) {
    *s = scale[scale_of(o->preset)];
    s->scale = scale_of(o->preset);
    if (!o->data_count && !s->size_px) s->size_px = MADE_PAPER_PX;
    if (o->size_px) s->size_px = o->size_px;
    if (o->people) s->people = o->people;
    if (o->seeds) s->seeds = o->seeds;
    if (o->minutes > 0) s->minutes = o->minutes, s->steps = s->halve_pictures = 0;
    if (o->steps) s->steps = o->steps, s->minutes = 0, s->halve_pictures = 0;
    s->test_people = s->people / 10 < 2 ? 2 : s->people / 10 > 30 ? 30 : s->people / 10;
}

/* The name without its folders, because assets may be elsewhere next time. */
static const char *file_name(const char *path) {
    const char *slash = path ? strrchr(path, '/') : NULL;
    return slash ? slash + 1 : path;
}

static bool add_text(cJSON *to, const char *key, const char *text) {
    return (text ? cJSON_AddStringToObject(to, key, text) : cJSON_AddNullToObject(to, key)) != NULL;
}

static bool add_number(cJSON *to, const char *key, double v) {
    return cJSON_AddNumberToObject(to, key, v) != NULL;
}

static bool add_data(cJSON *to, const sherf_experiment_options *o) {
    cJSON *data = cJSON_AddArrayToObject(to, "data"),
          *body = data ? cJSON_AddArrayToObject(to, "body") : NULL;
    for (int i = 0; i < o->data_count && body; i++) {
        cJSON *spec = cJSON_CreateString(o->data[i].data), *path = cJSON_CreateString(o->data[i].body);
        const bool added = spec && path && cJSON_AddItemToArray(data, spec);
        if (!added) cJSON_Delete(spec);
        if (!added || !cJSON_AddItemToArray(body, path)) {
            cJSON_Delete(path);
            return false;
        }
    }
    return body != NULL;
}

/* Adds the rates of methods that have their own. */
static bool add_rates(cJSON *to) {
    cJSON *rates = cJSON_AddObjectToObject(to, "rates");
    const experiment_method *m;
    for (int i = 0; rates && (m = experiment_method_at(i)); i++)
        if (m->rate > 0 && !m->own && !add_number(rates, m->key, m->rate)) return false;
    return rates != NULL;
}

static bool add_recipe(cJSON *to, const experiment_job *j) {
    const experiment_settings *s = &j->set;
    const bool made = !j->options->data_count;
    return add_text(to, "preset", scale_name[s->scale]) && add_number(to, "size", s->size_px) &&
           add_number(to, "people", made ? s->people : 0) && add_number(to, "minutes", s->minutes) &&
           add_number(to, "steps", (double)s->steps) && add_number(to, "seed", (double)j->options->seed) &&
           add_number(to, "batch", s->batch) && add_number(to, "targets", s->targets) &&
           add_number(to, "halve_pictures", (double)s->halve_pictures) &&
           add_number(to, "beta2", s->beta2 > 0 ? s->beta2 : adam_beta2) &&
           add_number(to, "test_poses", s->test_poses) &&
           (!made ||
            (add_number(to, "test_people", s->test_people) && add_number(to, "train_poses", s->train_poses) &&
             add_number(to, "train_views", s->train_views)));
}

/* Everything that determines a run's numbers; the number of seeds does not. NULL: out of memory. */
static cJSON *settings_json(const experiment_job *j) {
    const sherf_experiment_options *o = j->options;
    cJSON *s = cJSON_CreateObject();
    if (s && add_recipe(s, j) && add_rates(s) && add_data(s, o) &&
        add_text(s, "train_people", o->train_people) &&
        (!o->data_count || add_text(s, "test_people", o->test_people)) && /* made ones are counted */
        add_text(s, "motions", file_name(o->motions)) && add_text(s, "resnet18", file_name(o->resnet18)) &&
        add_text(s, "resnet34", file_name(o->resnet34)) && add_text(s, "lpips", file_name(o->lpips)) &&
        add_text(s, "perceptual", file_name(o->perceptual)) &&
        add_text(s, "precision", j->c->precision == SHERF_PRECISION_BF16 ? "bf16" : "fp32"))
        return s;
    cJSON_Delete(s);
    return NULL;
}

/* The first setting whose value in the file differs, or NULL. Older programs wrote fewer; without rates all
 * methods had SHERF's. */
static const char *settings_differ(const cJSON *now, const cJSON *old) {
    const cJSON *item;
    if (!cJSON_IsObject(old)) return "what it holds";
    cJSON_ArrayForEach(item, now) {
        const cJSON *before = cJSON_GetObjectItemCaseSensitive(old, item->string);
        if (before ? !cJSON_Compare(item, before, true) : !strcmp(item->string, "rates")) return item->string;
    }
    cJSON_ArrayForEach(item, old) {
        if (!cJSON_HasObjectItem(now, item->string)) return item->string;
    }
    return NULL;
}

static sherf_status settings_compare(const experiment_job *j, const cJSON *now, const char *path) {
    unsigned char *text = NULL;
    size_t bytes;
    sherf_status status = file_read(j->c, path, (size_t)1 << 20, &text, &bytes);
    if (status != SHERF_OK) return status;
    cJSON *old = cJSON_ParseWithLength((const char *)text, bytes);
    const char *what = settings_differ(now, old);
    if (what)
        status = failure(j->c, SHERF_MISMATCH,
                         "%s: made with other settings (%s differs, see %s); choose another folder",
                         j->options->output, what, path);
    cJSON_Delete(old);
    mem_free(text);
    return status;
}

/* Refuses a folder with other settings: its numbers belong together. */
static sherf_status settings_same(const experiment_job *j) {
    char path[PATH_LENGTH];
    cJSON *now = settings_json(j);
    char *text = now ? cJSON_Print(now) : NULL;
    sherf_status status = text ? job_path(j, path, "experiment.json") : SHERF_NO_MEMORY;
    if (status == SHERF_OK && path_is_file(path))
        status = settings_compare(j, now, path);
    else if (status == SHERF_OK && !j->options->dry_run) {
        status = folder_make(j->c, j->options->output);
        if (status == SHERF_OK) status = file_write(j->c, path, text, strlen(text));
    }
    cJSON_free(text);
    cJSON_Delete(now);
    return status;
}

/* ---- one experiment ---- */
static bool training_json(const experiment_job *j, const run *r, const training_facts *f, cJSON *list) {
    cJSON *o = cJSON_CreateObject();
    if (!o || !cJSON_AddItemToArray(list, o)) {
        cJSON_Delete(o);
        return false;
    }
    return cJSON_AddStringToObject(o, "method", r->method->label) &&
           cJSON_AddStringToObject(o, "preset", r->method->preset[j->set.scale]) &&
           cJSON_AddStringToObject(o, "data", r->data->label) &&
           cJSON_AddNumberToObject(o, "seed", (double)j->options->seed + r->seed + 1) &&
           cJSON_AddNumberToObject(o, "weights", f->weights) &&
           cJSON_AddNumberToObject(o, "steps", f->steps) &&
           cJSON_AddNumberToObject(o, "pictures", f->pictures) &&
           cJSON_AddNumberToObject(o, "minutes", f->minutes) &&
           cJSON_AddNumberToObject(o, "step_ms", f->step_ms);
}

static sherf_status trainings_json(const experiment_job *j, cJSON *made) {
    cJSON *list = cJSON_AddArrayToObject(made, "trainings");
    sherf_status status = list ? SHERF_OK : SHERF_NO_MEMORY;
    run r;
    for (int i = 0; status == SHERF_OK && run_at(j, i, &r); i++) {
        training_facts f;
        status = training_read(j, &r, &f);
        if (status == SHERF_OK && !training_json(j, &r, &f, list)) status = SHERF_NO_MEMORY;
    }
    return status;
}

/* Records how the page was made. */
static sherf_status made_json(const experiment_job *j, page *p) {
    cJSON *settings = settings_json(j);
    p->made = cJSON_CreateObject();
    if (!p->made || !settings || !cJSON_AddItemToObject(p->made, "settings", settings)) {
        cJSON_Delete(settings);
        return failure(j->c, SHERF_NO_MEMORY, "out of memory: the results");
    }
    if (!cJSON_AddStringToObject(p->made, "version", SHERF_VERSION) ||
        !cJSON_AddNumberToObject(p->made, "threads", j->c->threads) ||
        !cJSON_AddStringToObject(p->made, "processor", isa_name(isa_best())))
        return failure(j->c, SHERF_NO_MEMORY, "out of memory: the results");
    return trainings_json(j, p->made);
}

/* Appends NAME/table.md. */
static sherf_status text_append(const experiment_job *j, text_builder *text) {
    char path[PATH_LENGTH];
    unsigned char *table = NULL;
    size_t bytes;
    sherf_status status = job_path(j, path, "%s/table.md", j->experiment->name);
    if (status == SHERF_OK) status = file_read(j->c, path, (size_t)1 << 24, &table, &bytes);
    if (status == SHERF_OK) text_add(text, "%s", (const char *)table);
    mem_free(table);
    return status;
}

static sherf_status experiment_do(experiment_job *j, text_builder *text) {
    char folder[PATH_LENGTH];
    page *p = mem_zero(j->c, 1, sizeof *p);
    if (!p) return SHERF_NO_MEMORY;
    snprintf(p->name, sizeof p->name, "%s", j->experiment->name);
    snprintf(p->title, sizeof p->title, "%s", j->experiment->title);
    sherf_status status = runs_do(j);
    if (status == SHERF_OK) status = job_path(j, folder, "%s", j->experiment->name);
    if (status == SHERF_OK) status = folder_make(j->c, folder);
    if (status == SHERF_OK) status = j->experiment->report(j, p);
    if (status == SHERF_OK) status = made_json(j, p);
    if (status == SHERF_OK) status = page_write(j->c, p, folder);
    if (status == SHERF_OK) status = text_append(j, text);
    page_free(p);
    mem_free(p);
    return status;
}

/* Writes the folder's index.html, which lists the experiments that have pages. */
static sherf_status index_write(const experiment_job *j) {
    text_builder t = {.c = j->c};
    char path[PATH_LENGTH];
    text_add(
        &t,
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Experiments</title></head>\n"
        "<body style=\"font:16px/1.5 sans-serif;margin:2em "
        "auto;max-width:40em\">\n<h1>Experiments</h1>\n<ul>\n");
    for (int i = 0; experiment_at(i); i++) {
        const experiment *e = experiment_at(i);
        if (job_path(j, path, "%s/index.html", e->name) == SHERF_OK && path_is_file(path))
            text_add(&t, "<li><a href=\"%s/index.html\">%s</a></li>\n", e->name, e->title);
    }
    text_add(&t, "</ul>\n</body></html>\n");
    char *text = text_take(&t);
    sherf_status status = page_file_write(j->c, j->options->output, "index.html", text);
    mem_free(text);
    return status;
}

/* ---- which ---- */
static sherf_status no_such(context *c, const char *name) {
    text_builder t = {.c = c};
    for (int i = 0; experiment_at(i); i++) text_add(&t, "%s, ", experiment_at(i)->name);
    char *names = text_take(&t);
    if (!names) return SHERF_NO_MEMORY;
    sherf_status status =
        failure(c, SHERF_BAD_ARGUMENT, "experiment '%.60s': should be %sor all", name ? name : "", names);
    mem_free(names);
    return status;
}

/* Calls `once` with each experiment of that name; for "all", with those that lack nothing. */
static sherf_status each(experiment_job *j, const char *name,
                         sherf_status (*once)(experiment_job *j, void *arg), void *arg) {
    const bool all = !strcmp(name, "all");
    sherf_status status = SHERF_OK;
    for (int i = 0; experiment_at(i) && status == SHERF_OK; i++) {
        const experiment *e = j->experiment = experiment_at(i);
        if (!all && strcmp(e->name, name)) continue;
        const char *lack = experiment_lack(j);
        if (!lack)
            status = once(j, arg);
        else if (all)
            log_line(j->c, SHERF_LOG_INFO, "experiment %s is left out: it needs %s", e->name, lack);
        else
            status = failure(j->c, SHERF_BAD_ARGUMENT, "experiment %s needs %s", e->name, lack);
    }
    return status;
}

static sherf_status do_once(experiment_job *j, void *arg) {
    sherf_status status = experiment_do(j, arg);
    return status == SHERF_OK ? index_write(j) : status;
}

static sherf_status tell_once(experiment_job *j, void *arg) {
    return runs_tell(j, arg);
}

/* Appends the plan as text. */
static sherf_status dry_run(experiment_job *j, const char *name, text_builder *text) {
    run_tally t = {.text = {.c = j->c}};
    sherf_status status = each(j, name, tell_once, &t);
    text_add(&t.text, "%d trainings, about %.1f hours\n", t.trainings, t.hours);
    char *lines = text_take(&t.text);
    if (status == SHERF_OK && lines) text_add(text, "%s", lines);
    mem_free(lines);
    mem_free(t.seen);
    return status;
}

/* Makes it and reports it, or only scores the answers where there are some. */
static sherf_status make(experiment_job *j, const char *name, text_builder *text) {
    sherf_status status;
    if (j->options->answer_count && strcmp(name, "preference"))
        return failure(j->c, SHERF_BAD_ARGUMENT, "answers are scored of experiment preference, not of %s",
                       name);
    if (j->options->answer_count) return preference_score(j, text);
    if ((status = data_choose(j)) != SHERF_OK) return status;
    if ((status = settings_same(j)) != SHERF_OK) return status;
    return j->options->dry_run ? dry_run(j, name, text) : each(j, name, do_once, text);
}

sherf_status sherf_experiment(sherf_context *c, const char *name, const sherf_experiment_options *options,
                              char **text) {
    experiment_job *j = NULL;
    text_builder t = {.c = c};
    if (text) *text = NULL;
    sherf_status status = options_check(c, options);
    if (status != SHERF_OK) return status;
    if (!experiment_find(name) && (!name || strcmp(name, "all"))) return no_such(c, name);
    if (!(j = mem_zero(c, 1, sizeof *j))) return SHERF_NO_MEMORY;
    j->c = c;
    j->options = options;
    settings_take(options, &j->set);
    j->training_s = 60 * j->set.minutes;
    j->picture_s = 0.1;
    status = make(j, name, &t);
    char *made = text_take(&t);
    if (status == SHERF_OK && text) {
        *text = made;
        made = NULL;
        if (!*text) status = SHERF_NO_MEMORY;
    }
    mem_free(made);
    mem_free(j);
    return status;
}
