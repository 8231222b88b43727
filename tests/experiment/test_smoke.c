/* Tests that run every experiment as a smoke test on tube people: what is trained and scored, continuing, and
 * the written files. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include "base/path.h"
#include "eval/sheet.h"
#include "io/image.h"
#include "io/value.h"
#include "study_page.h"
#include "support.h"

static char root[512], spec[2][600], body[2][600];

static int make_data(void **state) {
    context *c = test_context();
    int failed = 0;
    snprintf(root, sizeof root, "%s", test_path("experiments"));
    for (int i = 0; i < 2; i++) {
        char folder[560];
        snprintf(folder, sizeof folder, "%s/tubes%d", root, i);
        snprintf(spec[i], sizeof spec[i], "thuman:%s", folder);
        snprintf(body[i], sizeof body[i], "%s/tubeman.safetensors", folder);
        const sherf_synth_options o = {
            .people = 3, .poses = 3, .views = 24, .size_px = 32, .seed = 40 + (uint64_t)i, .surfaces = !i};
        failed |= sherf_synth_tube(c, folder, &o) != SHERF_OK;
    }
    sherf_context_free(c);
    return failed;
}

/* Two data sets of tube people, the first with surfaces, and tiny networks, into a folder with this name. */
static sherf_experiment_options smoke(const char *folder) {
    static sherf_experiment_data data[2];
    static char path[4][600];
    static int next;
    for (int i = 0; i < 2; i++) data[i] = (sherf_experiment_data){spec[i], body[i]};
    char *output = path[next++ % 4];
    snprintf(output, sizeof path[0], "%s/%s", root, folder);
    return (sherf_experiment_options){.preset = "smoke",
                                      .output = output,
                                      .data = data,
                                      .data_count = 1,
                                      .train_people = "0",
                                      .test_people = "1-2",
                                      .size_px = 32,
                                      .seeds = 1,
                                      .steps = 2};
}

static document *json_of(context *c, const char *folder, const char *name) {
    char path[1400];
    document *d;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    assert_ok(c, json_read(c, path, &d));
    return d;
}

static double mean_of(const document *results, int table, int row, int column) {
    const value *t = value_at(value_get(results->root, "tables"), (size_t)table),
                *r = value_at(value_get(t, "rows"), (size_t)row),
                *v = value_get(value_at(value_get(r, "values"), (size_t)column), "mean");
    return v->kind == VALUE_REAL ? v->real : v->kind == VALUE_INTEGER ? (double)v->integer : NAN;
}

static void assert_same_file(context *c, const char *a, const char *b, const char *name) {
    char path[2][1400];
    unsigned char *data[2];
    size_t bytes[2];
    for (int i = 0; i < 2; i++) {
        snprintf(path[i], sizeof path[i], "%s/%s", i ? b : a, name);
        assert_ok(c, file_read(c, path[i], 1 << 24, &data[i], &bytes[i]));
    }
    assert_int_equal(bytes[0], bytes[1]);
    assert_memory_equal(data[0], data[1], bytes[0]);
    mem_free(data[0]);
    mem_free(data[1]);
}

static const char *const main_scores[] = {
    "runs/thuman/pixelnerf-1/scores/protocol/scores.json", "runs/thuman/nhp-1/scores/protocol/scores.json",
    "runs/thuman/mps-nerf-1/scores/protocol/scores.json", "runs/thuman/sherf-1/scores/protocol/scores.json"};

/* ---- the main table, interrupted again and again ---- */
/* Cancels at the n-th progress report. */
typedef struct {
    context *c;
    int left;
} cutter;

static void on_progress(void *user, const char *text, double done, double total) {
    cutter *k = user;
    if (k->left-- == 0) sherf_cancel(k->c);
}

static void main_goes_on_where_it_stopped(void **state) {
    context *c = test_context();
    const sherf_experiment_options whole = smoke("whole"), cut = smoke("cut");
    cutter k = {.c = c};
    char *text = NULL;
    int stops = 0;
    assert_ok(c, sherf_experiment(c, "main", &whole, &text));
    assert_non_null(strstr(text, "| MPS-NeRF |"));
    sherf_free(text);
    c->progress = on_progress;
    c->user = &k;
    for (;; stops++) {
        k.left = 3 + 37 * stops;
        sherf_cancel_reset(c);
        const sherf_status status = sherf_experiment(c, "main", &cut, NULL);
        if (status == SHERF_OK) break;
        assert_int_equal(status, SHERF_CANCELLED);
    }
    assert_true(stops >= 3);
    for (size_t i = 0; i < COUNT_OF(main_scores); i++)
        assert_same_file(c, whole.output, cut.output, main_scores[i]);
    assert_same_file(c, whole.output, cut.output, "main/novel-view.png");
    assert_same_file(c, whole.output, cut.output, "main/novel-pose.png");
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* The table matches the scorings' files, and the sheet has a column for each method. */
static void main_shows_its_scores(void **state) {
    context *c = test_context();
    const sherf_experiment_options o = smoke("whole");
    char path[1400];
    int width, height, channels;
    document *results = json_of(c, o.output, "main/results.json");
    for (size_t i = 0; i < COUNT_OF(main_scores); i++) {
        document *scored = json_of(c, o.output, main_scores[i]);
        const value *view = value_get(value_get(scored->root, "novel_view"), "psnr"),
                    *pose = value_get(value_get(scored->root, "novel_pose"), "psnr");
        assert_true(fabs(mean_of(results, 0, (int)i, 0) - view->real) < 1e-9);
        assert_true(i ? fabs(mean_of(results, 0, (int)i, 2) - pose->real) < 1e-9
                      : isnan(mean_of(results, 0, 0, 2)));
        if (i) /* SHERF minus this method, in the second table */
            assert_true(i == 3 || fabs(mean_of(results, 1, (int)i, 0) -
                                       (mean_of(results, 0, 3, 0) - mean_of(results, 0, (int)i, 0))) < 1e-9);
        document_free(scored);
    }
    assert_true(mean_of(results, 2, 3, 0) == 24.66); /* the paper's value, in a separate table */
    document_free(results);
    snprintf(path, sizeof path, "%s/main/novel-pose.png", o.output);
    assert_ok(c, image_size(c, path, &width, &height, &channels));
    assert_int_equal(width, (2 + 3) * SHEET_CELL_PX); /* PixelNeRF has no column */
    assert_true(height > 4 * SHEET_CELL_PX);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* A finished run is checked and kept; nothing is written again. */
static void finished_runs_stay(void **state) {
    context *c = test_context();
    const sherf_experiment_options o = smoke("whole");
    char path[1400];
    snprintf(path, sizeof path, "%s/runs/thuman/sherf-1/checkpoint.safetensors", o.output);
    assert_int_equal(unlink(path), 0); /* a training would write it again */
    assert_ok(c, sherf_experiment(c, "main", &o, NULL));
    assert_false(path_is_file(path));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void methods_have_their_rates(void **state) {
    static const char *const rate[][2] = {{"pixelnerf", "\"rate\": 0.0005,"},
                                          {"nhp", "\"rate\": 0.0005,"},
                                          {"mps-nerf", "\"rate\": 0.0005,"},
                                          {"sherf", "\"rate\": 0.002,"}};
    context *c = test_context();
    const sherf_experiment_options o = smoke("whole");
    for (size_t i = 0; i < COUNT_OF(rate); i++) {
        char path[1400];
        unsigned char *log;
        size_t bytes;
        snprintf(path, sizeof path, "%s/runs/thuman/%s-1/log.jsonl", o.output, rate[i][0]);
        assert_ok(c, file_read(c, path, 1 << 20, &log, &bytes));
        char *end = memchr(log, '\n', bytes);
        assert_non_null(end);
        *end = 0;
        if (!strstr((char *)log, rate[i][1])) fail_msg("%s: %s", rate[i][0], (char *)log);
        mem_free(log);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- the other experiments, which share its runs ---- */
static void the_others(void **state) {
    static const char *const plots[] = {"input-angle/input-angle", "angle-difference/angle-difference"};
    context *c = test_context();
    sherf_experiment_options o = smoke("others");
    char path[1400];
    o.data_count = 2;
    o.test_people = "1";
    static const char *const name[] = {"input-angle", "angle-difference", "ablation", "fusion",    "losses",
                                       "front-view",  "cross-data",       "runtime",  "preference"};
    for (size_t i = 0; i < COUNT_OF(name); i++) {
        assert_ok(c, sherf_experiment(c, name[i], &o, NULL));
        snprintf(path, sizeof path, "%s/%s/index.html", o.output, name[i]);
        assert_true(path_is_file(path));
    }
    for (size_t i = 0; i < COUNT_OF(plots); i++) {
        snprintf(path, sizeof path, "%s/%s.svg", o.output, plots[i]);
        assert_true(path_is_file(path));
    }
    document *angles = json_of(c, o.output, "input-angle/results.json");
    document *scored = json_of(c, o.output, "runs/thuman/sherf-1/scores/angles-0/scores.json");
    const value *images = value_get(scored->root, "images");
    assert_int_equal(value_count(images), 12 * 11);
    double sum = 0; /* over the pictures of the front view, column 5 of -150 ... 180 */
    for (size_t i = 0; i < value_count(images); i++) {
        const value *image = value_at(images, i);
        if (value_at(value_get(image, "observation"), 1)->integer == 12)
            sum += value_get(image, "psnr")->real / 11;
    }
    assert_true(fabs(mean_of(angles, 0, 2, 5) - sum) < 1e-6);
    document_free(scored);
    document_free(angles);
    document *ablation = json_of(c, o.output, "ablation/results.json");
    for (int row = 0; row < 6; row++)
        assert_true(mean_of(ablation, 0, row, 0) > 1 && mean_of(ablation, 0, row, 2) > 1);
    assert_true(mean_of(ablation, 0, 0, 0) != mean_of(ablation, 0, 5, 0));
    document_free(ablation);
    document *losses = json_of(c, o.output, "losses/results.json");
    for (int row = 0; row < 3; row++) assert_true(mean_of(losses, 0, row, 0) != mean_of(losses, 0, 4, 0));
    assert_true(mean_of(losses, 0, 3, 0) == mean_of(losses, 0, 4, 0)); /* there is no network here */
    document_free(losses);
    document *times = json_of(c, o.output, "runtime/results.json");
    for (int row = 0; row < 4; row++)
        assert_true(mean_of(times, 0, row, 1) > 0 && mean_of(times, 0, row, 2) > 0 &&
                    mean_of(times, 0, row, 4) > 1000);
    document_free(times);
    snprintf(path, sizeof path, "%s/preference/study.html", o.output);
    assert_true(path_is_file(path));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* A method's row has the surface distances of its scoring, in which some observations gave a surface. */
static void assert_surfaces(context *c, const document *results, const char *folder, int row,
                            const char *method) {
    static const char *const key[] = {"chamfer_cm", "to_truth_cm", "from_truth_cm", "normal_deg", "overlap"};
    char name[200];
    snprintf(name, sizeof name, "runs/thuman/%s-1/scores/surface/scores.json", method);
    document *scored = json_of(c, folder, name);
    const value *all = value_get(scored->root, "surfaces"), *mean = value_get(all, "mean");
    assert_true(value_get(all, "count")->integer > 0);
    for (size_t k = 0; k < COUNT_OF(key); k++)
        assert_true(fabs(mean_of(results, 0, row, 2 + (int)k) - value_get(mean, key[k])->real) < 1e-9);
    document_free(scored);
}

/* PIFu's surfaces and pictures next to SHERF's, without other poses. Complete work is not repeated, and lost
 * work is redone with the same result. */
static void pifu_has_surfaces(void **state) {
    static const char *const scored[] = {"runs/thuman/pifu-1/scores/protocol/scores.json",
                                         "runs/thuman/sherf-1/scores/protocol/scores.json"};
    context *c = test_context();
    const sherf_experiment_options o = smoke("pifu");
    char path[1400], kept[1400], *text;
    int width, height, channels;
    assert_ok(c, sherf_experiment(c, "pifu", &o, &text));
    assert_non_null(strstr(text, "PIFu learned from the people's surfaces"));
    assert_non_null(strstr(text, "PIFu: surfaces of "));
    assert_non_null(strstr(text, "SHERF: surfaces of "));
    sherf_free(text);
    document *results = json_of(c, o.output, "pifu/results.json");
    for (int i = 0; i < 2; i++) {
        document *d = json_of(c, o.output, scored[i]);
        const value *view = value_get(value_get(d->root, "novel_view"), "psnr");
        assert_true(fabs(mean_of(results, 0, i, 0) - view->real) < 1e-9);
        document_free(d);
    }
    assert_surfaces(c, results, o.output, 0, "pifu");
    assert_surfaces(c, results, o.output, 1, "sherf");
    assert_true(fabs(mean_of(results, 1, 0, 0) - (mean_of(results, 0, 1, 0) - mean_of(results, 0, 0, 0))) <
                1e-9);
    document_free(results);
    snprintf(path, sizeof path, "%s/pifu/novel-view.png", o.output);
    assert_ok(c, image_size(c, path, &width, &height, &channels));
    assert_int_equal(width, (2 + 2) * SHEET_CELL_PX);
    snprintf(path, sizeof path, "%s/pifu/novel-pose.png", o.output);
    assert_false(path_is_file(path));
    snprintf(path, sizeof path, "%s/%s", o.output, scored[0]);
    snprintf(kept, sizeof kept, "%s/kept/%s", o.output, scored[0]);
    char folder[1400];
    snprintf(folder, sizeof folder, "%s/kept/runs/thuman/pifu-1/scores/protocol", o.output);
    assert_ok(c, folder_make(c, folder));
    assert_int_equal(rename(path, kept), 0);
    snprintf(path, sizeof path, "%s/runs/thuman/pifu-1/checkpoint.safetensors", o.output);
    assert_int_equal(unlink(path), 0); /* a training would write it again */
    assert_ok(c, sherf_experiment(c, "pifu", &o, NULL));
    assert_false(path_is_file(path));
    snprintf(folder, sizeof folder, "%s/kept", o.output);
    assert_same_file(c, folder, o.output, scored[0]);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* People without surfaces, or a test person without a surface in the observed pose, are refused before any
 * training. */
static void pifu_wants_surfaces(void **state) {
    context *c = test_context();
    sherf_experiment_options o = smoke("none");
    char path[1400], away[1410], *text;
    o.data = &(sherf_experiment_data){spec[1], body[1]};
    assert_fails(c, sherf_experiment(c, "pifu", &o, NULL), SHERF_BAD_ARGUMENT,
                 "experiment pifu needs people's surfaces: ");
    assert_non_null(strstr(c->message, "tube_000/surface/0.safetensors: not there"));
    snprintf(path, sizeof path, "%s/runs", o.output);
    assert_false(path_is_folder(path));
    o = smoke("pifu");
    snprintf(path, sizeof path, "%s/tubes0/tube_002/surface/0.safetensors", root);
    snprintf(away, sizeof away, "%s.away", path);
    assert_int_equal(rename(path, away), 0);
    assert_fails(c, sherf_experiment(c, "pifu", &o, NULL), SHERF_BAD_ARGUMENT, "tube_002/surface/0");
    assert_int_equal(rename(away, path), 0);
    o.dry_run = 1;
    assert_ok(c, sherf_experiment(c, "pifu", &o, &text));
    assert_string_equal(text, "pifu\n0 trainings, about 0.0 hours\n");
    sherf_free(text);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Answers to each pair of the study that has none yet, all in favour of the first method. */
static char *answers_for(context *c, const document *key) {
    static char text[8192];
    const value *trials = value_get(key->root, "trials");
    size_t n = (size_t)snprintf(text, sizeof text,
                                "{\"format\": \"sherf-preference-answers\", \"version\": 1, \"study\": "
                                "\"%s\", \"rater\": \"r1\", \"consent\": true, \"trials\": [",
                                value_get(key->root, "study")->string.text);
    for (size_t i = 0; i < value_count(trials); i++) {
        const value *t = value_at(trials, i), *blurred = value_get(t, "blurred");
        const bool a =
            blurred->kind == VALUE_STRING ? value_is_string(blurred, "b") : value_get(t, "a")->integer == 0;
        n += (size_t)snprintf(text + n, sizeof text - n,
                              "%s{\"trial\": %zu, \"left\": \"a\", \"chose\": \"%s\", \"ms\": 500, "
                              "\"repeat\": false}",
                              i ? "," : "", i, a ? "left" : "right");
    }
    snprintf(text + n, sizeof text - n, "]}");
    return text;
}

/* Whether a method made this picture, which is then the left half of one in its scoring. */
static bool made_by(context *c, const char *output, const char *label, const image_u8 *shown) {
    const char *key = !strcmp(label, "SHERF") ? "sherf" : !strcmp(label, "NHP") ? "nhp" : "mps-nerf";
    char folder[700], path[1400];
    bool found = false;
    snprintf(folder, sizeof folder, "%s/runs/thuman/%s-1/scores/study", output, key);
    document *d = json_of(c, folder, "scores.json");
    const value *images = value_get(d->root, "images");
    for (size_t i = 0; i < value_count(images) && !found; i++) {
        image_u8 both;
        snprintf(path, sizeof path, "%s/%s", folder, value_get(value_at(images, i), "png")->string.text);
        assert_ok(c, image_read(c, path, 3, &both));
        found = both.width == 2 * shown->width && both.height == shown->height;
        for (int y = 0; y < shown->height && found; y++)
            found = !memcmp(both.data + 3 * (size_t)(y * both.width),
                            shown->data + 3 * (size_t)(y * shown->width), 3 * (size_t)shown->width);
        mem_free(both.data);
    }
    document_free(d);
    return found;
}

/* The key matches the page's pictures. */
static void pictures_are_their_methods(context *c, const char *output, const document *key) {
    char folder[700], path[700];
    snprintf(folder, sizeof folder, "%s/preference", output);
    snprintf(path, sizeof path, "%s/shown.png", root);
    document *page = study_page(c, folder);
    const value *trials = value_get(key->root, "trials"), *methods = value_get(key->root, "methods");
    for (size_t i = 0; i < value_count(trials); i++)
        for (size_t k = 0; k < 2; k++) {
            const value *t = value_at(trials, i), *blurred = value_get(t, "blurred");
            const char *label = value_at(methods, (size_t)value_get(t, k ? "b" : "a")->integer)->string.text;
            size_t bytes;
            image_u8 shown;
            const unsigned char *png = study_png(page, i, 1 + k, &bytes);
            assert_ok(c, file_write(c, path, png, bytes));
            assert_ok(c, image_read(c, path, 3, &shown));
            const bool sharp = blurred->kind != VALUE_STRING || !value_is_string(blurred, k ? "b" : "a");
            assert_int_equal(made_by(c, output, label, &shown), sharp);
            mem_free(shown.data);
        }
    document_free(page);
}

/* The study's answers become scores; a bad file is refused, and nothing is written. */
static void a_study_is_scored(void **state) {
    context *c = test_context();
    sherf_experiment_options o = smoke("others");
    char path[700], made[700], *text;
    const char *answers[] = {path};
    document *key = json_of(c, o.output, "preference/key.json");
    assert_true(value_count(value_get(key->root, "trials")) >= 6); /* two rivals, three kinds */
    pictures_are_their_methods(c, o.output, key);
    snprintf(path, sizeof path, "%s/answers.json", root);
    snprintf(made, sizeof made, "%s/preference/answers", o.output);
    o.answers = answers;
    o.answer_count = 1;
    assert_ok(c, file_write(c, path, "{}", 2));
    assert_fails(c, sherf_experiment(c, "preference", &o, NULL), SHERF_BAD_FILE,
                 "answers.json: not the answers");
    assert_false(path_is_folder(made));
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_BAD_ARGUMENT, "of experiment preference");
    const char *all = answers_for(c, key);
    assert_ok(c, file_write(c, path, all, strlen(all)));
    assert_ok(c, sherf_experiment(c, "preference", &o, &text));
    assert_non_null(strstr(text, "| SHERF against NHP | 100.0 ["));
    sherf_free(text);
    document *results = json_of(c, o.output, "preference/answers/results.json");
    assert_true(mean_of(results, 0, 0, 0) == 100 && mean_of(results, 0, 0, 2) == 3);
    assert_true(mean_of(results, 1, 0, 0) > mean_of(results, 1, 1, 0));
    document_free(results);
    document_free(key);
    o = smoke("nowhere");
    o.answers = answers;
    o.answer_count = 1;
    assert_fails(c, sherf_experiment(c, "preference", &o, NULL), SHERF_NO_FILE, "key.json");
    assert_false(path_is_folder(o.output));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Minutes are converted to steps, which the trainings then use. */
static void minutes_are_counted_in_steps(void **state) {
    context *c = test_context();
    sherf_experiment_options o = smoke("minutes");
    int64_t steps;
    o.steps = 0;
    o.minutes = 0.01;
    assert_ok(c, sherf_experiment(c, "main", &o, NULL));
    document *measured = json_of(c, o.output, "steps/thuman-sherf.json");
    assert_ok(c, value_integer(c, value_get(measured->root, "steps"), "steps", &steps));
    const double step_s = value_get(measured->root, "step_s")->real;
    assert_true(steps >= 1 && fabs((double)steps - fmax(1, floor(0.6 / step_s))) <= 1);
    document *d = json_of(c, o.output, "runs/thuman/sherf-1/finished.json");
    int64_t made;
    assert_ok(c, value_integer(c, value_get(d->root, "steps"), "steps", &made));
    assert_int_equal(made, steps);
    document_free(d);
    document_free(measured);
    char path[1400];
    snprintf(path, sizeof path, "%s/steps/pilot", o.output);
    assert_false(path_is_folder(path));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* A folder stores the whole recipe. Running it with another recipe is refused. */
static void the_recipe_is_kept(void **state) {
    static const char *const key[] = {"beta2", "halve_pictures", "batch", "targets", "test_poses", "steps"};
    context *c = test_context();
    sherf_experiment_options o = smoke("whole");
    char path[700], *text;
    unsigned char *kept;
    size_t bytes;
    document *d = json_of(c, o.output, "experiment.json");
    for (size_t i = 0; i < COUNT_OF(key); i++) assert_non_null(value_get(d->root, key[i]));
    assert_true(value_get(d->root, "beta2")->real == 0.99);
    assert_true(value_is_string(value_get(d->root, "precision"), "fp32") ||
                value_is_string(value_get(d->root, "precision"), "bf16"));
    document_free(d);
    snprintf(path, sizeof path, "%s/experiment.json", o.output);
    assert_ok(c, file_read(c, path, 1 << 20, &kept, &bytes));
    char *at = strstr((char *)kept, "0.99");
    assert_non_null(at);
    memcpy(at, "0.98", 4);
    assert_ok(c, file_write(c, path, kept, bytes));
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_MISMATCH, "(beta2 differs");
    memcpy(at, "0.99", 4);
    assert_non_null(at = strstr((char *)kept, "\"rates\""));
    memcpy(at, "\"speed\"", 7); /* as written by a program whose methods all had the same one */
    assert_ok(c, file_write(c, path, kept, bytes));
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_MISMATCH, "(rates differs");
    memcpy(at, "\"rates\"", 7);
    assert_ok(c, file_write(c, path, kept, bytes));
    o.dry_run = 1;
    assert_ok(c, sherf_experiment(c, "main", &o, &text));
    sherf_free(text);
    assert_ok(c, file_write(c, path, "{", 1));
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_MISMATCH, "what it holds differs");
    assert_ok(c, file_write(c, path, kept, bytes));
    mem_free(kept);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- plans and mistakes ---- */
static void a_dry_run_makes_nothing(void **state) {
    context *c = test_context();
    sherf_experiment_options o = smoke("dry");
    char *text;
    o.dry_run = 1;
    o.seeds = 2;
    assert_ok(c, sherf_experiment(c, "main", &o, &text));
    assert_non_null(strstr(text, "\n8 trainings, about "));
    assert_non_null(strstr(text, "\n  SHERF (small,"));
    assert_false(path_is_folder(o.output));
    sherf_free(text);
    o = smoke("whole");
    o.dry_run = 1;
    assert_ok(c, sherf_experiment(c, "main", &o, &text));
    assert_string_equal(text, "main\n0 trainings, about 0.0 hours\n");
    sherf_free(text);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void mistakes_are_one_line(void **state) {
    context *c = test_context();
    sherf_experiment_options o = smoke("whole");
    assert_fails(c, sherf_experiment(c, "dance", &o, NULL), SHERF_BAD_ARGUMENT,
                 "'dance': should be main, ablation");
    assert_fails(c, sherf_experiment(c, "estimated-body", &o, NULL), SHERF_BAD_ARGUMENT,
                 "the networks that see people");
    assert_fails(c, sherf_experiment(c, "cross-data", &o, NULL), SHERF_BAD_ARGUMENT, "two data sets");
    o.steps = 3;
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_MISMATCH,
                 "made with other settings (steps differs");
    o = smoke("bad");
    o.preset = "grand";
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_BAD_ARGUMENT, "smoke, quick or paper");
    o = smoke("bad");
    o.minutes = 1;
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_BAD_ARGUMENT, "not both");
    o = smoke("bad");
    o.people = 10;
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_BAD_ARGUMENT, "made ones");
    o = smoke("bad");
    o.test_people = "7";
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_BAD_ARGUMENT, "no people 7");
    o = smoke("bad2");
    o.data = &(sherf_experiment_data){"thuman:/nowhere", body[0]};
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_NO_FILE, "/nowhere: no such folder");
    assert_false(path_is_folder(o.output));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* A folder of made people is continued: its record agrees with itself. Here the people cannot be drawn. */
static void made_people_are_gone_on_with(void **state) {
    context *c = test_context();
    char path[1400];
    sherf_experiment_options o = smoke("made");
    o.data_count = 0;
    o.train_people = o.test_people = NULL;
    o.source = "/nowhere";
    o.body = body[0];
    for (int i = 0; i < 2; i++)
        assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_NO_FILE, "/nowhere");
    snprintf(path, sizeof path, "%s/experiment.json", o.output);
    assert_true(path_is_file(path));
    o.people = 8;
    assert_fails(c, sherf_experiment(c, "main", &o, NULL), SHERF_MISMATCH, "(people differs");
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Another method's weights in a run's folder are refused with their name, and stay. */
static void weights_of_another_method(void **state) {
    context *c = test_context();
    const sherf_experiment_options o = smoke("others");
    char from[1400], to[1400], folder[1400];
    snprintf(from, sizeof from, "%s/runs/thuman/sherf-1/checkpoint.safetensors", o.output);
    sherf_experiment_options foreign = smoke("foreign");
    snprintf(folder, sizeof folder, "%s/foreign/runs/thuman/nhp-1", root);
    snprintf(to, sizeof to, "%s/foreign/runs/thuman/nhp-1/checkpoint.safetensors", root);
    assert_ok(c, folder_make(c, folder));
    assert_int_equal(rename(from, to), 0);
    assert_fails(c, sherf_experiment(c, "input-angle", &foreign, NULL), SHERF_MISMATCH,
                 "checkpoint.safetensors");
    assert_true(path_is_file(to));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(main_goes_on_where_it_stopped),
        cmocka_unit_test(main_shows_its_scores),
        cmocka_unit_test(finished_runs_stay),
        cmocka_unit_test(methods_have_their_rates),
        cmocka_unit_test(the_others),
        cmocka_unit_test(pifu_has_surfaces),
        cmocka_unit_test(pifu_wants_surfaces),
        cmocka_unit_test(a_study_is_scored),
        cmocka_unit_test(minutes_are_counted_in_steps),
        cmocka_unit_test(the_recipe_is_kept),
        cmocka_unit_test(a_dry_run_makes_nothing),
        cmocka_unit_test(mistakes_are_one_line),
        cmocka_unit_test(made_people_are_gone_on_with),
        cmocka_unit_test(weights_of_another_method),
    };
    return cmocka_run_group_tests(tests, make_data, NULL);
}
