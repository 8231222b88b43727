/* experiment: the paper's comparisons as data (methods.c, plan.c), their people (people.c), their trainings
 * and scorings (runs.c, run.c), and the resulting folder of tables, plots and sheets (report.c, page.h).
 *
 * A run is a training of one method on one data set with one seed. It has a folder of its own with its
 * scores. Finished work is not repeated, so an experiment can be interrupted at any time and continued, and
 * experiments share their runs. */
#ifndef SHERF_EXPERIMENT_INSIDE_H
#define SHERF_EXPERIMENT_INSIDE_H

#include "base/path.h"
#include "data/text.h"
#include "eval/estimated.h"
#include "experiment/page.h"
#include "experiment/scores.h"

typedef struct experiment_job experiment_job;

/* ---- methods.c, plan.c: experiments as data ---- */
/* Presets of experiments: tiny ones that show that everything runs, small networks for a CPU, and the
 * paper's. */
typedef enum { SCALE_SMOKE, SCALE_QUICK, SCALE_PAPER, SCALES } experiment_scale;
/* A method and how it is trained. */
typedef struct {
    const char *key;   /* of its folder */
    const char *label; /* in tables */
    const char *preset[SCALES];
    int resnet[SCALES];   /* layers of the ResNet that its encoder can start from; 0: none */
    const char *steps_of; /* key of the method whose number of steps it takes; NULL: its own */
    const char *without;  /* terms that its loss leaves out, as in sherf_train_options */
    double rate;          /* Adam's at the start, in the matched recipe; 0: SHERF's */
    bool front_view;      /* people are observed from the front only */
    bool own;             /* its authors' recipe */
    bool on_request;      /* only if requested by name */
    bool one_pose;        /* shows no novel poses */
} experiment_method;
const experiment_method *experiment_method_find(const char *key);
const experiment_method *experiment_method_at(int i); /* from 0; NULL after the last */

/* How a run is scored. */
typedef enum {
    SCORING_PROTOCOL,  /* by the data set's protocol; of quick, a part of it */
    SCORING_FRONT,     /* the same, observed from the front view only */
    SCORING_ANGLES,    /* observed from each target view in turn, compared with the others */
    SCORING_ESTIMATED, /* the protocol with bodies, cameras and masks estimated from the pictures */
    SCORING_DISTURBED, /* the protocol with bodies disturbed by a given number of millimetres (disturb.h) */
    SCORING_VIEWS,     /* a few pictures to look at, in the observed pose */
    SCORING_POSES,     /* a few pictures to look at, in other poses */
    SCORING_STUDY,     /* pictures for a study of preferences, kept as files */
    SCORING_SURFACE,   /* surfaces; few pictures, which are not looked at */
    SCORING_KINDS
} scoring_kind;
typedef struct {
    scoring_kind kind;
    int level;    /* SCORING_DISTURBED: millimetres */
    bool crossed; /* on the other data set's test people */
} scoring;

enum { EXPERIMENT_METHODS = 8, EXPERIMENT_SCORINGS = 8, SEEDS_MAX = 16 };
typedef struct {
    const char *name, *title;
    sherf_status (*report)(experiment_job *j, page *out);
    const char *method[EXPERIMENT_METHODS]; /* keys; NULL ends them */
    int scorings;
    scoring scoring[EXPERIMENT_SCORINGS];
    bool all_seeds;   /* otherwise the first one only */
    bool all_data;    /* trained on each data set; otherwise on the first one */
    bool both_ways;   /* trained on the first two */
    bool surfaces;    /* needs people's surfaces (data/surface_truth.h) */
    const char *note; /* for its page; or NULL */
} experiment;
const experiment *experiment_at(int i); /* from 0; NULL after the last */
const experiment *experiment_find(const char *name);

/* ---- published.c: the paper's numbers ---- */
/* The paper's table for this experiment, if it has one. */
sherf_status published_add(context *c, page *p, const char *experiment_name);

/* ---- people.c: data sets ---- */
typedef struct {
    char label[64], key[64];                              /* in tables; of folders */
    char train[PATH_LENGTH + 16], test[PATH_LENGTH + 16]; /* specs */
    char train_people[32], test_people[32];               /* of made people; "": the options' */
    char body[PATH_LENGTH];
    bool made, tubes;  /* synthetic people, drawn by this program if missing; tube people */
    bool only_crossed; /* only for testing models trained on other data, and for the reverse */
} experiment_data;
/* The given data sets, or the synthetic one. */
sherf_status data_choose(experiment_job *j);
/* Draws missing synthetic people, and surfaces where the current experiment needs them. */
sherf_status data_make(experiment_job *j, const experiment_data *d);
/* Whether people have the surfaces that training needs and, for tests, the ones to compare with. Otherwise
 * the message names the first missing one. */
sherf_status data_has_surfaces(experiment_job *j, const experiment_data *d);
const char *data_train_people(const experiment_job *j, const experiment_data *d); /* NULL: the paper's */
const char *data_test_people(const experiment_job *j, const experiment_data *d);

/* The pictures that a scoring uses, in the terms of sherf_eval_options; "": the protocol. */
typedef struct {
    char people[2048], observations[1024], poses[256], views[256];
    int64_t pictures; /* number of rendered pictures */
    int poses_observed;
} scoring_selection;
/* pose: for SCORING_ANGLES the observed pose, from 0 up to poses_observed; otherwise 0 of 1. */
sherf_status scoring_select(experiment_job *j, const experiment_data *d, const scoring *s, int pose,
                            scoring_selection *out);

/* ---- the job ---- */
enum { EXPERIMENT_DATA_MAX = 8 };
typedef struct {
    experiment_scale scale;
    int size_px, people, test_people, train_poses, train_views, test_poses, seeds, batch, targets;
    double minutes;                /* of a training; 0: steps limit it */
    int64_t steps, halve_pictures; /* 0: minutes limit it; the rate is halved after each fifth of the steps */
    double beta2;                  /* 0: the training's */
} experiment_settings;
struct experiment_job {
    context *c;
    const sherf_experiment_options *options;
    experiment_settings set;
    int data_count;
    experiment_data data[EXPERIMENT_DATA_MAX];
    const experiment *experiment; /* the current one */
    char lack[1200];              /* text of experiment_lack */
    /* for the time that is left */
    int trainings_left;
    int64_t pictures_left;
    double training_s, picture_s; /* measured; guesses before that */
};
sherf_status job_path(const experiment_job *j, char out[PATH_LENGTH], const char *format, ...)
    PRINTF_LIKE(3, 4);

/* ---- runs.c ---- */
typedef struct {
    const experiment_method *method;
    const experiment_data *data; /* its training data */
    int seed;                    /* from 0 */
} run;
/* The current experiment's runs in order; false after the last. */
bool run_at(const experiment_job *j, int i, run *out);
/* Whether methods are trained on data set i, or only tested. */
bool data_is_trained_on(const experiment_job *j, int i);
/* Whether the run has this scoring: methods without novel poses skip those, and pictures to look at come from
 * one seed. */
bool run_has(const run *r, const scoring *s);
const experiment_data *scoring_data(const experiment_job *j, const run *r, const scoring *s);
/* A file of a run, or of one of its scorings. */
sherf_status run_path(const experiment_job *j, const run *r, const char *name, char out[PATH_LENGTH]);
sherf_status scoring_path(const experiment_job *j, const run *r, const scoring *s, int pose, const char *name,
                          char out[PATH_LENGTH]);
/* Logs a line: the current step and the estimated time left. */
void run_tell(experiment_job *j, const run *r, const char *what);

/* ---- run.c ---- */
/* What the current experiment needs and lacks, as text that is valid until the next call; NULL: nothing. */
const char *experiment_lack(experiment_job *j);
/* Trains and scores what the current experiment lacks. */
sherf_status runs_do(experiment_job *j);
/* Calls `once` for every missing scoring of a run, once for each pose. */
typedef sherf_status scoring_function(experiment_job *j, const run *r, const scoring *s, int pose,
                                      const scoring_selection *k, void *arg);
sherf_status run_scorings(experiment_job *j, const run *r, scoring_function *once, void *arg);

/* ---- training.c ---- */
/* If trainings are limited by minutes, measures how many steps the coming ones take. */
sherf_status steps_ready(experiment_job *j);
/* Pictures in a step: samples times targets. */
sherf_status training_step_pictures(const experiment_job *j, const experiment_method *method, int *out);
/* Trains, unless the training is finished. */
sherf_status training_do(experiment_job *j, const run *r);
/* A finished training's own record, for tables. */
typedef struct {
    double steps, pictures, minutes, step_ms, weights;
} training_facts;
sherf_status training_read(const experiment_job *j, const run *r, training_facts *out);

/* ---- tally.c ---- */
/* A step of one picture and a frame, timed as in `sherf bench`. */
typedef struct {
    const char *preset;
    double step_ms, frame_ms;
} preset_time;
/* What an experiment lacks and how long that takes, for dry runs. Each run or scoring counts once: `seen`
 * holds those that earlier experiments would have made. */
typedef struct {
    text_builder text;
    int count, capacity;
    char (*seen)[256];
    double hours;
    int trainings;
    int timed_count;
    preset_time timed[2 * EXPERIMENT_METHODS];
} run_tally;
sherf_status runs_tell(experiment_job *j, run_tally *t);
/* ---- report.c ---- */
sherf_status report_scores(experiment_job *j, page *out);
sherf_status report_cross(experiment_job *j, page *out);
sherf_status report_front(experiment_job *j, page *out);
sherf_status report_pifu(experiment_job *j, page *out);
sherf_status report_estimated(experiment_job *j, page *out);
/* angles.c, runtime.c */
sherf_status report_input_angle(experiment_job *j, page *out);
sherf_status report_angle_difference(experiment_job *j, page *out);
sherf_status report_runtime(experiment_job *j, page *out);
/* preference.c: the page of a study (study.h) with the methods' pictures. */
sherf_status report_preference(experiment_job *j, page *out);
/* preference_score.c: turns the answers in job->options into tables in FOLDER/preference/answers and appends
 * them to the text. */
sherf_status preference_score(experiment_job *j, text_builder *text);
/* The scores of all seeds of a method trained on `data`, *count of them; the caller frees them. */
sherf_status report_read(experiment_job *j, const experiment_method *method, const experiment_data *data,
                         const scoring *s, int pose, scores out[SEEDS_MAX], int *count);
/* Adds the end of every page: the paper's numbers, the trainings, sheets, notes. */
sherf_status report_end(experiment_job *j, page *p);
void scores_free_all(scores *s, int count);
/* gallery.c: writes sheets with the experiment's methods side by side into its folder. */
sherf_status gallery_add(experiment_job *j, page *p);

#endif
