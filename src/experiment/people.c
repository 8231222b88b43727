/* The people to train on and to test, and the pictures of them that a scoring uses. */
#include <stdio.h>
#include <string.h>

#include "data/dataset.h"
#include "data/surface_truth.h"
#include "experiment/experiment.h"
#include "train/surfaces.h"

/* Test people wear clothes that nobody below this number wears (sherf_people_options). */
enum { TRAIN_FIRST = 1000, TEST_FIRST = 900000, VIEWS = 24 };

/* ---- data sets ---- */
static sherf_status made_data(experiment_job *j, const char *label, bool tubes, experiment_data *d) {
    const char *what = tubes ? "tubes" : "people";
    char folder[PATH_LENGTH];
    *d = (experiment_data){.made = true, .tubes = tubes, .only_crossed = tubes};
    snprintf(d->label, sizeof d->label, "%s", label);
    snprintf(d->key, sizeof d->key, "%s", what);
    snprintf(d->train_people, sizeof d->train_people, "0-%d", j->set.people - 1);
    snprintf(d->test_people, sizeof d->test_people, "0-%d", j->set.test_people - 1);
    sherf_status status = job_path(j, folder, "people/%s-train", what);
    if (status == SHERF_OK)
        status = job_path(j, d->body, "people/%s-train/%s.safetensors", what, tubes ? "tubeman" : "body");
    snprintf(d->train, sizeof d->train, "thuman:%s", folder);
    if (status == SHERF_OK) status = job_path(j, folder, "people/%s-test", what);
    snprintf(d->test, sizeof d->test, "thuman:%s", folder);
    return status;
}

static bool named_before(const experiment_job *j, const char *key) {
    for (int i = 0; i < j->data_count; i++)
        if (!strcmp(j->data[i].key, key)) return true;
    return false;
}

static sherf_status given_data(experiment_job *j, int i, experiment_data *d) {
    const sherf_experiment_data *from = &j->options->data[i];
    sherf_dataset *data = NULL;
    if (!from->data || !from->body)
        return failure(j->c, SHERF_BAD_ARGUMENT, "a data set and its body are needed");
    sherf_status status = sherf_dataset_open(j->c, from->data, &data);
    if (status != SHERF_OK) return status;
    *d = (experiment_data){0};
    snprintf(d->key, sizeof d->key, "%s", dataset_protocol(data)->name);
    if (named_before(j, d->key))
        snprintf(d->key, sizeof d->key, "%s-%d", dataset_protocol(data)->name, i + 1);
    memcpy(d->label, d->key, sizeof d->label);
    if (snprintf(d->train, sizeof d->train, "%s", from->data) >= (int)sizeof d->train ||
        snprintf(d->body, sizeof d->body, "%s", from->body) >= (int)sizeof d->body)
        status = failure(j->c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", from->data);
    memcpy(d->test, d->train, sizeof d->test);
    sherf_dataset_free(data);
    return status;
}

sherf_status data_choose(experiment_job *j) {
    sherf_status status = SHERF_OK;
    if (j->options->data_count > EXPERIMENT_DATA_MAX - 1 || j->options->data_count < 0)
        return failure(j->c, SHERF_BAD_ARGUMENT, "at most %d data sets can be compared",
                       EXPERIMENT_DATA_MAX - 1);
    for (int i = 0; i < j->options->data_count && status == SHERF_OK; i++)
        if ((status = given_data(j, i, &j->data[i])) == SHERF_OK) j->data_count++;
    if (j->data_count || status != SHERF_OK) return status;
    status = made_data(j, "made people", false, &j->data[0]);
    if (status == SHERF_OK) status = made_data(j, "tube people", true, &j->data[1]);
    j->data_count = 2;
    return status;
}

const char *data_train_people(const experiment_job *j, const experiment_data *d) {
    return *d->train_people ? d->train_people : j->options->train_people;
}

const char *data_test_people(const experiment_job *j, const experiment_data *d) {
    return *d->test_people ? d->test_people : j->options->test_people;
}

/* ---- drawing them ---- */
static sherf_status draw_people(experiment_job *j, const experiment_data *d, const char *folder, bool test) {
    const experiment_settings *s = &j->set;
    const int people = test ? s->test_people : s->people, poses = test ? s->test_poses : s->train_poses,
              views = test ? VIEWS : s->train_views;
    const uint64_t seed = test ? TEST_FIRST : TRAIN_FIRST;
    log_line(j->c, SHERF_LOG_INFO, "drawing %d %s, %d poses and %d views of each%s: %s", people, d->label,
             poses, views, j->experiment->surfaces ? ", and surfaces" : "", folder);
    if (d->tubes)
        return sherf_synth_tube(j->c, folder, &(sherf_synth_options){people, poses, views, s->size_px, seed});
    const sherf_people_options o = {.people = people,
                                    .poses = poses,
                                    .views = views,
                                    .size_px = s->size_px,
                                    .seed = seed,
                                    .source = j->options->source,
                                    .body = j->options->body,
                                    .motions = j->options->motions,
                                    .surfaces = j->experiment->surfaces};
    return sherf_synth_people(j->c, folder, &o);
}

/* ---- the scored pictures ---- */
enum {
    POSES_MAX = 64,
    VIEWS_MAX = 64,
    PAIRS_MAX = 128,
    LOOKED_AT = 4,
    ANGLE_PEOPLE = 6,
    STUDY_PEOPLE = 10,
    STUDY_VIEWS = 6
};
/* As much of the protocol as the people allow; for quick, fewer poses and every other view, for smoke every
 * fourth. */
typedef struct {
    const data_protocol *protocol;
    int people, poses, views, angles, observed_views, front;
    int pose[POSES_MAX], view[VIEWS_MAX], angle[VIEWS_MAX], observed_view[3];
    bool whole;       /* the whole protocol */
    char names[2048]; /* of the first people, for galleries, angles and studies */
} picture_choice;

typedef struct {
    int observations, poses, views;
    picture observation[PAIRS_MAX];
    int pose[POSES_MAX], view[VIEWS_MAX];
} picks;

/* Counts for made people, before they are drawn. */
static void counts_made(const experiment_job *j, const data_protocol *p, picture_choice *out, int *poses,
                        int *views) {
    *poses = j->set.test_poses;
    *views = VIEWS;
    out->people = j->set.test_people;
    out->protocol = p;
}

static void fill_choice(const experiment_job *j, bool made, int has_poses, int has_views,
                        picture_choice *out) {
    const data_protocol *p = out->protocol;
    const int step = p->view_step > 0 ? p->view_step : 1, limit = has_views < p->views ? has_views : p->views;
    const int max = j->set.scale == SCALE_PAPER ? p->pose_count : j->set.test_poses;
    const int every = j->set.scale == SCALE_PAPER ? 1 : j->set.scale == SCALE_QUICK ? 2 : 4;
    for (int i = 0; i < max && out->poses < POSES_MAX; i++) {
        const int pose = made ? i : p->pose_first + i * p->pose_step;
        if (pose < has_poses) out->pose[out->poses++] = pose;
    }
    for (int v = 0; v < limit && out->angles < VIEWS_MAX; v += step) {
        out->angle[out->angles++] = v;
        if (v % (every * step) == 0) out->view[out->views++] = v;
    }
    for (size_t i = 0; i < COUNT_OF(p->observation_views); i++)
        if (p->observation_views[i] < has_views)
            out->observed_view[out->observed_views++] = p->observation_views[i];
    out->front = protocol_front(p, limit);
    out->whole = j->set.scale == SCALE_PAPER && !made;
}

static sherf_status names_of(experiment_job *j, const sherf_dataset *data, const int *person, int count,
                             picture_choice *out) {
    size_t used = 0;
    for (int i = 0; i < count && i < STUDY_PEOPLE; i++) {
        const char *name = sherf_dataset_person(data, person[i]);
        const int n = snprintf(out->names + used, sizeof out->names - used, "%s%s", i ? "," : "", name);
        if (n < 0 || (used += (size_t)n) >= sizeof out->names || strchr(name, ','))
            return failure(j->c, SHERF_UNSUPPORTED, "%s: people with such names cannot be listed", name);
    }
    return SHERF_OK;
}

static sherf_status choose(experiment_job *j, const experiment_data *d, picture_choice *out) {
    sherf_dataset *data = NULL;
    int *person = NULL, count = 0, poses, views;
    const char *folder;
    *out = (picture_choice){0};
    const dataset_reader *reader = dataset_reader_named(d->test, &folder);
    if (d->made && j->options->dry_run && !path_is_folder(folder)) {
        counts_made(j, &reader->protocol, out, &poses, &views);
        fill_choice(j, true, poses, views, out);
        return SHERF_OK;
    }
    sherf_status status = sherf_dataset_open(j->c, d->test, &data);
    if (status == SHERF_OK)
        status = dataset_people(j->c, data, data_test_people(j, d), false, &person, &count);
    if (status == SHERF_OK) {
        out->protocol = dataset_protocol(data);
        out->people = count;
        fill_choice(j, d->made, sherf_dataset_pose_count(data, person[0]),
                    sherf_dataset_view_count(data, person[0]), out);
        status = names_of(j, data, person, count, out);
    }
    if (status == SHERF_OK && (!out->poses || !out->views))
        status = failure(j->c, SHERF_BAD_ARGUMENT,
                         "%s: the test people have none of the protocol's poses and views", d->test);
    if (status == SHERF_OK && !out->observed_views) out->observed_view[out->observed_views++] = out->view[0];
    mem_free(person);
    sherf_dataset_free(data);
    return status;
}

/* ---- surfaces ---- */
/* Whether there are surfaces of the poses that a training observes. */
static sherf_status trained_surfaces(experiment_job *j, const experiment_data *d) {
    sherf_dataset *data = NULL;
    sampling s = {0};
    sherf_status status = sherf_dataset_open(j->c, d->train, &data);
    if (status == SHERF_OK) status = sampling_create(j->c, data, data_train_people(j, d), false, 1, 0, &s);
    if (status == SHERF_OK) status = surfaces_are_there(j->c, data, &s);
    sampling_free(&s);
    sherf_dataset_free(data);
    return status;
}

/* Whether there are surfaces of the poses that a scoring by the protocol observes. */
static sherf_status tested_surfaces(experiment_job *j, const experiment_data *d) {
    picture_choice k;
    sherf_dataset *data = NULL;
    char path[PATH_LENGTH];
    int *person = NULL, count = 0;
    sherf_status status = choose(j, d, &k);
    if (status == SHERF_OK) status = sherf_dataset_open(j->c, d->test, &data);
    if (status == SHERF_OK)
        status = dataset_people(j->c, data, data_test_people(j, d), false, &person, &count);
    for (int i = 0; i < count && status == SHERF_OK; i++)
        for (int p = 0; p < (k.whole ? k.poses : 1) && status == SHERF_OK; p++)
            status = surface_truth_find(j->c, data, person[i], k.pose[p], path);
    mem_free(person);
    sherf_dataset_free(data);
    return status;
}

sherf_status data_has_surfaces(experiment_job *j, const experiment_data *d) {
    const sherf_status status = trained_surfaces(j, d);
    return status == SHERF_OK ? tested_surfaces(j, d) : status;
}

sherf_status data_make(experiment_job *j, const experiment_data *d) {
    for (int test = 0; test < 2 && d->made; test++) {
        const char *folder;
        char list[PATH_LENGTH];
        sherf_status status = SHERF_OK;
        dataset_reader_named(test ? d->test : d->train, &folder);
        if (snprintf(list, sizeof list, "%s/human_list.txt", folder) >= (int)sizeof list)
            return failure(j->c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", folder);
        const bool drawn = path_is_file(list); /* it is written last */
        if (drawn && j->experiment->surfaces) status = test ? tested_surfaces(j, d) : trained_surfaces(j, d);
        if (drawn && status == SHERF_OK) continue;
        if (status == SHERF_OK || status == SHERF_NO_FILE) status = draw_people(j, d, folder, test != 0);
        if (status != SHERF_OK) return status;
    }
    return SHERF_OK;
}

/* ---- pictures ---- */
static void observe(picks *p, int pose, int view) {
    if (p->observations < PAIRS_MAX) p->observation[p->observations++] = (picture){pose, view};
}

/* The names in order, at most `max` of them. */
static void first_names(const char *names, int max, char out[2048]) {
    snprintf(out, 2048, "%s", names);
    for (char *p = out; *p; p++)
        if (*p == ',' && !--max) *p = 0;
}

static void pick_protocol(const picture_choice *k, picks *p) {
    for (int i = 0; i < k->observed_views; i++) observe(p, k->pose[0], k->observed_view[i]);
    memcpy(p->pose, k->pose, sizeof p->pose);
    memcpy(p->view, k->view, sizeof p->view);
    p->poses = k->poses, p->views = k->views;
}

/* One or two pictures of each observation: only its surface is looked at. */
static void pick_surface(const picture_choice *k, picks *p) {
    pick_protocol(k, p);
    if (p->poses > 1) p->poses = 1;
    if (p->views > 2) p->views = 2;
}

static void pick_front(const picture_choice *k, bool paper, picks *p) {
    pick_protocol(k, p);
    p->observations = 0;
    for (int i = 0; i < (paper ? k->poses : 1); i++) observe(p, k->pose[i], k->front);
}

static void pick_angles(const picture_choice *k, int pose, picks *p) {
    for (int i = 0; i < k->angles; i++) {
        observe(p, k->pose[pose], k->angle[i]);
        p->view[p->views++] = k->angle[i];
    }
    p->pose[p->poses++] = k->pose[pose];
}

/* Four pictures: of the observed pose, or of two others from two views each (of one from four). The views are
 * evenly spread. */
static void pick_looks(const picture_choice *k, bool poses, picks *p) {
    const int seen = k->observed_view[0], max = poses && k->poses > 2 ? LOOKED_AT / 2 : LOOKED_AT;
    int other[VIEWS_MAX], n = 0;
    observe(p, k->pose[0], seen);
    for (int i = 0; i < k->angles; i++)
        if (poses || k->angle[i] != seen) other[n++] = k->angle[i];
    for (int i = 0; i < max && i < n; i++) p->view[p->views++] = other[n > max ? i * n / max : i];
    for (int i = poses ? 1 : 0; i < k->poses && p->poses < (poses ? 2 : 1); i++)
        p->pose[p->poses++] = k->pose[i];
}

/* Six views evenly spaced round the person, in the observed pose and in another. */
static void pick_study(const picture_choice *k, picks *p) {
    const int n = k->angles < STUDY_VIEWS ? k->angles : STUDY_VIEWS;
    observe(p, k->pose[0], k->observed_view[0]);
    for (int i = 0; i < n; i++) p->view[p->views++] = k->angle[i * k->angles / n];
    for (int i = 0; i < k->poses && i < 2; i++) p->pose[p->poses++] = k->pose[i];
}

static int64_t pairs(const picks *p) {
    int64_t n = 0;
    for (int o = 0; o < p->observations; o++)
        for (int i = 0; i < p->poses; i++)
            for (int v = 0; v < p->views; v++)
                n += p->pose[i] != p->observation[o].pose || p->view[v] != p->observation[o].view;
    return n;
}

/* The number of pairs in the protocol itself. */
static int64_t protocol_pairs(const picture_choice *k) {
    const int64_t observed = k->observed_views;
    return k->poses * observed * (k->views - 1) + observed * (k->poses - 1) * k->views;
}

static bool list_text(const int *list, int n, char *out, size_t room) {
    size_t used = 0;
    for (int i = 0; i < n && used < room; i++)
        used += (size_t)snprintf(out + used, room - used, "%s%d", i ? "," : "", list[i]);
    return used < room;
}

static bool pairs_text(const picture *list, int n, char *out, size_t room) {
    size_t used = 0;
    for (int i = 0; i < n && used < room; i++)
        used +=
            (size_t)snprintf(out + used, room - used, "%s%d:%d", i ? "," : "", list[i].pose, list[i].view);
    return used < room;
}

sherf_status scoring_select(experiment_job *j, const experiment_data *d, const scoring *s, int pose,
                            scoring_selection *out) {
    picture_choice k;
    picks p = {0};
    int people;
    *out = (scoring_selection){.poses_observed = 1};
    sherf_status status = choose(j, d, &k);
    if (status != SHERF_OK) return status;
    people = k.people;
    const char *test = data_test_people(j, d);
    snprintf(out->people, sizeof out->people, "%s", test ? test : "");
    if (s->kind == SCORING_ANGLES) {
        out->poses_observed = j->set.scale == SCALE_PAPER ? k.poses : 1;
        pick_angles(&k, pose, &p);
    } else if (s->kind == SCORING_FRONT) {
        pick_front(&k, j->set.scale == SCALE_PAPER, &p);
    } else if (s->kind == SCORING_VIEWS || s->kind == SCORING_POSES) {
        pick_looks(&k, s->kind == SCORING_POSES, &p);
        people = people < LOOKED_AT ? people : LOOKED_AT;
        first_names(k.names, LOOKED_AT, out->people);
    } else if (s->kind == SCORING_STUDY) {
        pick_study(&k, &p);
        people = people < STUDY_PEOPLE ? people : STUDY_PEOPLE;
        snprintf(out->people, sizeof out->people, "%s", k.names);
    } else if (s->kind == SCORING_SURFACE) {
        pick_surface(&k, &p);
    } else if (k.whole) {
        out->pictures = people * protocol_pairs(&k);
        return SHERF_OK;
    } else {
        pick_protocol(&k, &p);
    }
    if (s->kind == SCORING_ANGLES && j->set.scale != SCALE_PAPER) {
        people = people < ANGLE_PEOPLE ? people : ANGLE_PEOPLE;
        first_names(k.names, ANGLE_PEOPLE, out->people);
    }
    out->pictures = people * pairs(&p);
    if (!list_text(p.pose, p.poses, out->poses, sizeof out->poses) ||
        !list_text(p.view, p.views, out->views, sizeof out->views) ||
        !pairs_text(p.observation, p.observations, out->observations, sizeof out->observations))
        return failure(j->c, SHERF_UNSUPPORTED, "%s: too many poses and views to list", d->test);
    return SHERF_OK;
}
