/* The study's material: pictures of the test people near the observed camera, far from it and in another
 * pose, by every method. It is chosen before anybody looks at it. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/dataset.h"
#include "experiment/angles.h"
#include "experiment/experiment.h"
#include "experiment/study.h"
#include "io/value.h"

static const double near_deg = 60.5, far_deg = 119.5; /* near: up to this; far: from this */
enum { PICTURES_MAX = 4096, CANDIDATES_MAX = 64 };

typedef struct {
    int person, observed[2], pose, view; /* of the study's people */
    char file[256];
} made_picture;
typedef struct {
    experiment_job *j;
    sherf_dataset *data;
    sherf_body *body;
    int methods;
    run run[STUDY_METHODS]; /* the subject first */
    int count[STUDY_METHODS];
    made_picture *made[STUDY_METHODS];
    study s;
    int pictures;
    study_picture *picture; /* of the page */
} study_material;

static void material_free(study_material *material) {
    for (int i = 0; i < STUDY_METHODS; i++) mem_free(material->made[i]);
    for (int i = 0; i < material->pictures; i++) mem_free(material->picture[i].png);
    mem_free(material->picture);
    study_free(&material->s);
    sherf_body_free(material->body);
    sherf_dataset_free(material->data);
}

/* ---- rendered pictures ---- */
static int person_of(const study *s, const value *name) {
    for (int i = 0; i < s->people; i++)
        if (name && value_is_string(name, s->person[i])) return i;
    return -1;
}

static bool whole(const value *v, int *out) {
    if (!v || v->kind != VALUE_INTEGER || v->integer < 0 || v->integer > INT32_MAX) return false;
    *out = (int)v->integer;
    return true;
}

static bool read_picture(const value *o, const study *s, made_picture *out) {
    const value *file = value_get(o, "png"), *seen = value_get(o, "observation");
    *out = (made_picture){.person = person_of(s, value_get(o, "person"))};
    if (!file || file->kind != VALUE_STRING || strchr(file->string.text, '/') || !seen) return false;
    snprintf(out->file, sizeof out->file, "%s", file->string.text);
    return out->person >= 0 && whole(value_at(seen, 0), &out->observed[0]) &&
           whole(value_at(seen, 1), &out->observed[1]) && whole(value_get(o, "pose"), &out->pose) &&
           whole(value_get(o, "view"), &out->view);
}

/* Takes the people of the first list that is read. */
static sherf_status people_take(study_material *material, const value *root) {
    const value *people = value_get(root, "people");
    const size_t n = people ? value_count(people) : 0;
    if (material->s.person) return SHERF_OK;
    if (n < 1 || n > STUDY_TRIALS_MAX)
        return failure(material->j->c, SHERF_BAD_FILE, "not the scores of a study");
    material->s.person = mem_zero(material->j->c, n, sizeof *material->s.person);
    if (!material->s.person) return SHERF_NO_MEMORY;
    for (; material->s.people < (int)n; material->s.people++) {
        const value *name = value_get(value_at(people, (size_t)material->s.people), "person");
        if (name && name->kind == VALUE_STRING)
            snprintf(material->s.person[material->s.people], STUDY_NAME, "%s", name->string.text);
    }
    return SHERF_OK;
}

static sherf_status read_list(study_material *material, int method, const value *root) {
    const value *images = value_get(root, "images");
    const size_t n = images ? value_count(images) : 0;
    if (n > PICTURES_MAX) return failure(material->j->c, SHERF_BAD_FILE, "not the scores of a study");
    material->made[method] = mem_zero(material->j->c, n + 1, sizeof **material->made);
    if (!material->made[method]) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++)
        if (read_picture(value_at(images, i), &material->s, &material->made[method][material->count[method]]))
            material->count[method]++;
    return SHERF_OK;
}

static sherf_status read_method(study_material *material, int method) {
    char path[PATH_LENGTH];
    document *d = NULL;
    const scoring *s = &material->j->experiment->scoring[0];
    sherf_status status = scoring_path(material->j, &material->run[method], s, 0, "scores.json", path);
    if (status == SHERF_OK) status = json_read(material->j->c, path, &d);
    if (status != SHERF_OK) return status;
    status = people_take(material, d->root);
    if (status == SHERF_OK) status = read_list(material, method, d->root);
    document_free(d);
    return status == SHERF_OK ? status : failure_prefix(material->j->c, status, "%s", path);
}

/* The subject is SHERF, at any place among the methods. */
static sherf_status methods_read(study_material *material) {
    run r;
    int other = 1;
    for (int i = 0; run_at(material->j, i, &r) && other < STUDY_METHODS; i++)
        material->run[!strcmp(r.method->key, "sherf") ? 0 : other++] = r;
    material->methods = material->s.methods = other;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < material->methods && status == SHERF_OK; i++) {
        snprintf(material->s.method[i], STUDY_NAME, "%s", material->run[i].method->label);
        status = read_method(material, i);
    }
    return status;
}

/* ---- which of it ---- */
/* STUDY_STRATA: in no stratum. */
static sherf_status stratum_of(const study_material *material, const made_picture *k, int *stratum) {
    context *c = material->j->c;
    sherf_camera seen, shown;
    sherf_pose pose;
    double degrees = 0;
    *stratum = STUDY_POSE;
    if (k->pose != k->observed[0]) return SHERF_OK;
    const int person =
        dataset_find(material->data, material->s.person[k->person], strlen(material->s.person[k->person]));
    if (person < 0)
        return failure(c, SHERF_MISMATCH, "%s is not among the test people", material->s.person[k->person]);
    sherf_status status = dataset_camera(c, material->data, person, k->observed[1], &seen);
    if (status == SHERF_OK) status = dataset_camera(c, material->data, person, k->view, &shown);
    if (status == SHERF_OK) status = dataset_pose(c, material->data, person, k->pose, &pose);
    if (status == SHERF_OK) status = camera_angle(c, material->body, &pose, &seen, &shown, &degrees);
    *stratum = fabs(degrees) <= near_deg ? STUDY_NEAR : fabs(degrees) >= far_deg ? STUDY_FAR : STUDY_STRATA;
    return status;
}

/* Draws one of a person's pictures at random; *out NULL: there is none. */
static sherf_status choose(const study_material *material, int person, int stratum,
                           const made_picture **out) {
    const made_picture *candidate[CANDIDATES_MAX];
    int n = 0;
    *out = NULL;
    for (int i = 0; i < material->count[0] && n < CANDIDATES_MAX; i++) {
        const made_picture *k = &material->made[0][i];
        int of;
        if (k->person != person) continue;
        sherf_status status = stratum_of(material, k, &of);
        if (status != SHERF_OK) return status;
        if (of == stratum) candidate[n++] = k;
    }
    const uint64_t key = random_key(material->j->options->seed, "study.choice", (uint64_t)person);
    if (n) *out = candidate[random_below(key, (uint64_t)stratum, n)];
    return SHERF_OK;
}

static const made_picture *same_picture(const study_material *material, int method, const made_picture *k) {
    for (int i = 0; i < material->count[method]; i++) {
        const made_picture *p = &material->made[method][i];
        if (p->person == k->person && p->pose == k->pose && p->view == k->view) return p;
    }
    return NULL;
}

/* ---- onto the page ---- */
/* *index: the picture's number. */
static sherf_status picture_add(study_material *material, const image_u8 *image, int *index) {
    study_picture *p = &material->picture[material->pictures];
    *index = material->pictures;
    sherf_status status =
        png_to_memory(material->j->c, image->width, image->height, 3, image->data, 6, &p->png, &p->bytes);
    if (status == SHERF_OK) material->pictures++;
    return status;
}

/* Reads the left part of an evaluation's picture: the method's result. */
static sherf_status result_read(const study_material *material, int method, const made_picture *k,
                                image_u8 *out) {
    char path[PATH_LENGTH];
    *out = (image_u8){0};
    sherf_status status = scoring_path(material->j, &material->run[method],
                                       &material->j->experiment->scoring[0], 0, k->file, path);
    if (status == SHERF_OK) status = image_read(material->j->c, path, 3, out);
    if (status != SHERF_OK) return status;
    const size_t whole_row = 3 * (size_t)out->width, row = 3 * (size_t)(out->width / 2);
    for (int y = 0; y < out->height; y++)
        memmove(out->data + (size_t)y * row, out->data + (size_t)y * whole_row, row);
    out->width /= 2;
    return SHERF_OK;
}

static sherf_status input_add(study_material *material, const made_picture *k, int *index) {
    context *c = material->j->c;
    sherf_observation *o = NULL;
    image_u8 image = {0};
    const int person =
        dataset_find(material->data, material->s.person[k->person], strlen(material->s.person[k->person]));
    sherf_status status = dataset_observation(c, material->data, person, k->observed[0], k->observed[1],
                                              material->j->set.size_px, &o);
    if (status != SHERF_OK) return status;
    const size_t n = 3 * (size_t)o->image.width * (size_t)o->image.height;
    image = (image_u8){o->image.width, o->image.height, 3, mem_alloc(c, n, 1)};
    for (size_t i = 0; image.data && i < n; i++) image.data[i] = float_to_u8(o->image.data[i]);
    status = image.data ? picture_add(material, &image, index) : SHERF_NO_MEMORY;
    mem_free(image.data);
    sherf_observation_free(o);
    return status;
}

/* Adds a pair with its sides in random order. */
static void trial_add(study_material *material, study_trial t) {
    const uint64_t key = random_key(material->j->options->seed, "study.sides", (uint64_t)material->s.trials);
    if (random_below(key, 0, 2)) {
        const study_trial same = t;
        for (int k = 0; k < 2; k++) t.method[k] = same.method[1 - k], t.picture[1 + k] = same.picture[2 - k];
        t.blurred = !t.blurred;
    }
    material->s.trial[material->s.trials++] = t;
}

/* Pairs the subject with each other method that has the picture, and perhaps with its own blurred copy. */
static sherf_status pairs_add(study_material *material, const made_picture *k, int input, int stratum,
                              bool with_catch) {
    context *c = material->j->c;
    image_u8 image = {0}, blurred = {0};
    int shown, index;
    sherf_status status = result_read(material, 0, k, &image);
    if (status == SHERF_OK) status = picture_add(material, &image, &shown);
    if (status == SHERF_OK && with_catch) status = study_blur(c, &image, &blurred);
    if (status == SHERF_OK && with_catch && (status = picture_add(material, &blurred, &index)) == SHERF_OK)
        trial_add(material, (study_trial){.person = k->person,
                                          .stratum = stratum,
                                          .picture = {input, shown, index},
                                          .is_catch = true,
                                          .blurred = 1});
    for (int i = 1; i < material->methods && status == SHERF_OK; i++) {
        const made_picture *other = same_picture(material, i, k);
        if (!other) continue;
        mem_free(image.data);
        status = result_read(material, i, other, &image);
        if (status == SHERF_OK) status = picture_add(material, &image, &index);
        if (status == SHERF_OK)
            trial_add(material, (study_trial){.person = k->person,
                                              .stratum = stratum,
                                              .method = {0, i},
                                              .picture = {input, shown, index}});
    }
    mem_free(image.data);
    mem_free(blurred.data);
    return status;
}

/* Whether a person gets a catch trial: the first ones go to people in turn, stratum by stratum. */
static bool has_catch(const study_material *material, int person, int stratum) {
    const int at = stratum * material->s.people + (person + stratum) % material->s.people;
    const int all = STUDY_STRATA * material->s.people;
    return at * STUDY_CATCHES / all != (at + 1) * STUDY_CATCHES / all;
}

static sherf_status trials_make(study_material *material) {
    const size_t trials = (size_t)material->s.people * STUDY_STRATA * (STUDY_METHODS + 1);
    material->s.trial = mem_zero(material->j->c, trials, sizeof *material->s.trial);
    material->picture =
        mem_zero(material->j->c, trials + (size_t)material->s.people, sizeof *material->picture);
    sherf_status status = material->s.trial && material->picture ? SHERF_OK : SHERF_NO_MEMORY;
    for (int person = 0; person < material->s.people && status == SHERF_OK; person++)
        for (int stratum = 0, input = -1; stratum < STUDY_STRATA && status == SHERF_OK; stratum++) {
            const made_picture *k;
            if ((status = choose(material, person, stratum, &k)) != SHERF_OK || !k) continue;
            if (input < 0) status = input_add(material, k, &input);
            if (status == SHERF_OK)
                status = pairs_add(material, k, input, stratum, has_catch(material, person, stratum));
        }
    return status;
}

/* ---- its page ---- */
static sherf_status counts_table(const study_material *material, page *p) {
    context *c = material->j->c;
    page_table *t = page_add_table(c, p, "Trials");
    sherf_status status = t ? SHERF_OK : SHERF_NO_MEMORY;
    static const char *const name[] = {"near view", "far view", "novel pose"};
    for (int k = 0; k < STUDY_STRATA && status == SHERF_OK; k++)
        status = page_add_column(c, t, "", name[k], 0, 0);
    for (int i = 1; i <= material->methods && status == SHERF_OK; i++) {
        int count[STUDY_STRATA] = {0};
        for (int k = 0; k < material->s.trials; k++) {
            const study_trial *q = &material->s.trial[k];
            count[q->stratum] += i == material->methods ? q->is_catch : q->method[0] + q->method[1] == i;
        }
        page_row *row = i == material->methods
                            ? page_add_row(c, t, "catch trials")
                            : page_add_row(c, t, "SHERF against %s", material->s.method[i]);
        for (int k = 0; row && k < STUDY_STRATA; k++) row->value[k] = interval_of(count[k]);
        status = row ? SHERF_OK : SHERF_NO_MEMORY;
    }
    return status;
}

static sherf_status how_to(const study_material *material, page *p) {
    context *c = material->j->c;
    sherf_status status = page_add_note(
        c, p,
        "study.html is the study, whole in one file: put it on any web server, or open it as it is. key.json "
        "says what is what and stays here. Each rater sees up to %d pairs, all catch trials (a result "
        "against its blurred copy) and %d pairs again with sides exchanged, in an order of their own, and "
        "saves a file of answers at the end.",
        STUDY_DRAWN, STUDY_REPEATS);
    if (status == SHERF_OK)
        status = page_add_note(
            c, p,
            "sherf experiment preference --score -o FOLDER answers*.json turns these files into scores.");
    return status;
}

sherf_status report_preference(experiment_job *j, page *p) {
    study_material material = {.j = j};
    char folder[PATH_LENGTH];
    const experiment_data *d = &j->data[0];
    sherf_status status = sherf_dataset_open(j->c, d->test, &material.data);
    if (status == SHERF_OK) status = sherf_body_load(j->c, d->body, &material.body);
    if (status == SHERF_OK) status = methods_read(&material);
    if (status == SHERF_OK) status = trials_make(&material);
    if (status == SHERF_OK && !material.s.trials)
        status = failure(j->c, SHERF_BAD_ARGUMENT, "%s: no picture to show in a study", d->test);
    if (status == SHERF_OK) status = job_path(j, folder, "%s", j->experiment->name);
    if (status == SHERF_OK)
        status = study_write(j->c, &material.s, material.pictures, material.picture,
                             random_key(j->options->seed, "study", 0), folder);
    if (status == SHERF_OK) status = counts_table(&material, p);
    if (status == SHERF_OK) status = how_to(&material, p);
    material_free(&material);
    return status;
}
