/* sherf experiment: the paper's comparisons, one command each. */
#include <stdlib.h>
#include <string.h>

#include "photo.h"
#include "session.h"
#include "shared.h"
#include "verbs.h"

static struct {
    const char *output, *preset, *train_people, *test_people, *body, *source, *motions, *resnet18, *resnet34,
        *lpips, *perceptual;
    option_files data;
    int64_t size, people, seeds, steps;
    double minutes;
    bool own, dry_run, score;
} set;

static const option options[] = {
    {'o', "output", OPTION_FILE, &set.output, "FOLDER",
     "runs, scores and, for each experiment, tables, plots and sheets; what is finished there is kept",
     .needed = true},
    {'p', "preset", OPTION_TEXT, &set.preset, "NAME",
     "quick: small networks and pictures, for two cores; paper; smoke: tiny, to test that everything runs "
     "(quick)"},
    {'d', "data", OPTION_FILES, &set.data, "SPEC",
     "data set, as in sherf train; again for another one; without any, people are made"},
    {0, "train-people", OPTION_TEXT, &set.train_people, "LIST", "of the data sets (the paper's)"},
    {0, "test-people", OPTION_TEXT, &set.test_people, "LIST", "of the data sets (the paper's)"},
    SHARED_BODY_OF_DATA(&set.body),
    SHARED_SOURCE(&set.source, "made people", ""),
    SHARED_MOTIONS(&set.motions, "made people"),
    {'s', "size", OPTION_INTEGER, &set.size, "N", "pictures are N wide (quick: 128)", 16, 4096},
    {0, "people", OPTION_INTEGER, &set.people, "N",
     "made people to train on, a tenth more for tests (quick: 100)", 2, 100000},
    {0, "seeds", OPTION_INTEGER, &set.seeds, "N", "trainings of each method in the main table (quick: 3)", 1,
     16},
    {0, "minutes-per-training", OPTION_REAL, &set.minutes, "X",
     "as many steps as fit in X minutes, by a step that is measured first (quick: 12)", 0.001, 1e6},
    {'n', "steps", OPTION_INTEGER, &set.steps, "N",
     "steps of each training, in place of minutes (paper: 50000)", 1, 1e12},
    {0, "own", OPTION_FLAG, &set.own, NULL, "main: also train rivals by their authors' recipes"},
    {0, "resnet", OPTION_FILE, &set.resnet18, "FILE", "converted ResNet-18 that encoders start from"},
    {0, "resnet34", OPTION_FILE, &set.resnet34, "FILE", "converted ResNet-34, for those that have one"},
    SHARED_LPIPS(&set.lpips, ", for losses and scores"),
    SHARED_PERCEPTUAL(&set.perceptual, "the resnet50 distance", "none"),
    {0, "score", OPTION_FLAG, &set.score, NULL,
     "preference: score the ANSWERS, the files of the study's raters, and make nothing else"},
    {0, "dry-run", OPTION_FLAG, &set.dry_run, NULL,
     "say what is missing and how long it takes, and make nothing"},
    {0},
};

enum { DATA_MAX = 7 };

/* A body for each data set; the path stays valid. */
static int data_take(session *s, sherf_experiment_data *out, char *body[DATA_MAX]) {
    if (set.data.count > DATA_MAX) return usage_error(s->verb_name, "--data: at most %d data sets", DATA_MAX);
    for (int i = 0; i < set.data.count; i++) {
        const char *path = session_body(s, set.body, set.data.file[i]);
        if (!path) return EXIT_USAGE;
        if (!(body[i] = strdup(path))) return session_failure("out of memory");
        out[i] = (sherf_experiment_data){set.data.file[i], body[i]};
    }
    return EXIT_DONE;
}

static int experiment(session *s, int count, char **argument, const sherf_experiment_data *data) {
    const bool made = !set.data.count && !set.score;
    const char *body = made ? session_body(s, set.body, NULL) : NULL, *name = argument[0];
    if (made && !body) return EXIT_USAGE;
    const sherf_experiment_options o = {.preset = set.preset,
                                        .output = set.output,
                                        .data = data,
                                        .data_count = set.data.count,
                                        .train_people = set.train_people,
                                        .test_people = set.test_people,
                                        .source = set.source ? set.source : session_people_source(),
                                        .body = body,
                                        .motions = set.motions,
                                        .resnet18 = set.resnet18,
                                        .resnet34 = set.resnet34,
                                        .lpips = set.lpips,
                                        .perceptual = session_perceptual(set.perceptual),
                                        .estimator = session_asset(NULL, PHOTO_NETWORKS),
                                        .size_px = (int)set.size,
                                        .people = (int)set.people,
                                        .seeds = (int)set.seeds,
                                        .minutes = set.minutes,
                                        .steps = set.steps,
                                        .seed = (uint64_t)common.seed,
                                        .own = set.own,
                                        .answers = (const char *const *)(argument + 1),
                                        .answer_count = count - 1,
                                        .dry_run = set.dry_run};
    char *text = NULL;
    int status = session_status(s, sherf_experiment(s->context, name, &o, &text));
    if (!status) session_text("folder", set.output, text);
    sherf_free(text);
    return status;
}

static int run(session *s, int count, char **argument) {
    sherf_experiment_data data[DATA_MAX];
    char *body[DATA_MAX] = {NULL};
    if (set.score && strcmp(argument[0], "preference"))
        return usage_error(s->verb_name, "--score is of the experiment preference");
    if (set.score && count < 2) return usage_error(s->verb_name, "--score: the files of answers are missing");
    if (!set.score && count > 1)
        return usage_error(s->verb_name, "'%s' is one argument too many", argument[1]);
    int status = data_take(s, data, body);
    if (!status) status = experiment(s, count, argument, data);
    for (int i = 0; i < DATA_MAX; i++) free(body[i]);
    return status;
}

const verb verb_experiment = {
    .name = "experiment",
    .arguments = "NAME [ANSWERS...]",
    .summary = "run the paper's comparisons: trainings, scores, tables, plots",
    .description =
        "Trains what an experiment of the paper lacks, scores it, and writes FOLDER/NAME: table.md, "
        "table.tex, results.json, plots, sheets of pictures and index.html, the paper's own numbers beside. "
        "NAME is main, ablation, fusion, losses, front-view, input-angle, angle-difference, cross-data, "
        "estimated-body, runtime, preference, pifu, or all. Whatever is finished is kept, so the same "
        "command "
        "goes on after any end, and experiments share trainings. A folder holds runs of the same options; "
        "others are refused. preference makes a web page of blind pairs, FOLDER/preference/study.html; with "
        "--score it turns the files that its raters saved into scores.",
    .example = "sherf experiment main -o quick --dry-run\n"
               "sherf experiment all -o quick\n"
               "sherf experiment preference -o quick --score answers-*.json\n"
               "sherf experiment main --preset paper --data thuman:THuman/nerf_data_ --body body.safetensors "
               "-o paper",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 10001,
    .words = "main|ablation|fusion|losses|front-view|input-angle|angle-difference|cross-data|estimated-body|"
             "runtime|preference|pifu|all",
    .computes = true,
    .run = run,
};
