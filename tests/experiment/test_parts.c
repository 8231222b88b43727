/* Tests of the parts of experiments: intervals, scores from files, pages, plots, angles, disturbed bodies,
 * the plan. */
#include <math.h>
#include <stdio.h>

#include "data/data.h"
#include "experiment/angles.h"
#include "experiment/disturb.h"
#include "experiment/experiment.h"
#include "eval/pose_error.h"
#include "io/canvas.h"
#include "model/model.h"
#include "support.h"
#include "synth/tube/tubeman.h"

static char *text_of(context *c, const char *folder, const char *name) {
    char path[1200];
    unsigned char *data;
    size_t bytes;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    assert_ok(c, file_read(c, path, 1 << 20, &data, &bytes));
    return (char *)data;
}

static void assert_in(const char *text, const char *part) {
    if (!strstr(text, part)) fail_msg("no \"%s\" in:\n%s", part, text);
}

/* ---- intervals ---- */
/* For normal numbers the bootstrap's ends are about 1.96 standard errors from the mean. */
static void intervals_cover(void **state) {
    enum { N = 400 };
    context *c = *state;
    double x[N], sum = 0, squares = 0;
    interval v;
    for (int i = 0; i < N; i++) sum += x[i] = 20 + 3 * random_normal(7, (uint64_t)i);
    for (int i = 0; i < N; i++) squares += pow(x[i] - sum / N, 2);
    const double error = sqrt(squares / N / N);
    assert_ok(c, interval_bootstrap(c, N, x, NULL, 1, &v));
    assert_true(fabs(v.mean - sum / N) < 1e-12);
    assert_true(fabs((v.high - v.mean) / error - 1.96) < 0.15 &&
                fabs((v.mean - v.low) / error - 1.96) < 0.15);
}

static void intervals_of_little(void **state) {
    context *c = *state;
    interval v;
    assert_ok(c, interval_bootstrap(c, 1, (double[]){3}, NULL, 1, &v));
    assert_true(v.mean == 3 && isnan(v.low) && isnan(v.high));
    assert_ok(c, interval_bootstrap(c, 3, (double[]){2, NAN, 4}, NULL, 1, &v));
    assert_true(v.mean == 3 && v.low == 2 && v.high == 4);
    assert_ok(c, interval_bootstrap(c, 1, (double[]){NAN}, NULL, 1, &v));
    assert_true(isnan(v.mean));
    /* A person with three times the pictures has three times the weight; a person with none has none. */
    assert_ok(c, interval_bootstrap(c, 3, (double[]){2, 4, 9}, (double[]){3, 1, 0}, 1, &v));
    assert_true(v.mean == 2.5 && v.low == 2 && v.high == 4);
}

/* ---- scores ---- */
static const char two_people[] =
    "{\"images\": [{\"person\": \"a\", \"observation\": [0, 4], \"pose\": 0, \"view\": 8, \"kind\": "
    "\"novel_view\", \"psnr\": 20}, {\"person\": \"b\", \"observation\": [0, 4], \"pose\": 0, \"view\": 8, "
    "\"kind\": \"novel_view\", \"psnr\": 20}, {\"person\": \"b\", \"observation\": [0, 4], \"pose\": 2, "
    "\"view\": 8, \"kind\": "
    "\"novel_pose\", "
    "\"psnr\": 21}], \"people\": ["
    "{\"person\": \"a\", \"novel_view\": {\"psnr\": 20, \"ssim\": 0.5, \"lpips\": null, \"resnet50\": 0.25}, "
    "\"novel_pose\": {\"psnr\": 19}}, "
    "{\"person\": \"b\", \"novel_view\": {\"psnr\": %g}, \"novel_pose\": {\"psnr\": 18}}], "
    "\"novel_view\": {\"psnr\": 22}, \"novel_pose\": {\"psnr\": 18.5}}";

static void scores_make(context *c, double b, scores *out) {
    char text[2048];
    snprintf(text, sizeof text, two_people, b);
    const char *path = test_path("scores.json");
    assert_ok(c, file_write(c, path, text, strlen(text)));
    assert_ok(c, scores_read(c, path, out));
}

static void scores_of_a_file(void **state) {
    context *c = *state;
    scores s[2], other;
    interval v;
    scores_make(c, 24, &s[0]);
    scores_make(c, 28, &s[1]);
    scores_make(c, 21, &other);
    assert_int_equal(s->people, 2);
    assert_int_equal(s->pictures, 3);
    assert_true(s->picture[2].person == 1 && s->picture[2].novel_pose && s->picture[2].observed_view == 4 &&
                s->picture[2].pose == 2 && s->picture[2].view == 8 && s->picture[2].psnr == 21);
    assert_true(s->person[0].mean[0][METRIC_SSIM] == 0.5 && isnan(s->person[0].mean[0][METRIC_LPIPS]));
    assert_ok(c, scores_interval(c, s, NULL, 1, SCORED_VIEW, METRIC_PSNR, &v));
    assert_true(v.mean == 22 && v.low == 20 && v.high == 24);
    assert_ok(c, scores_interval(c, s, NULL, 2, SCORED_VIEW, METRIC_PSNR, &v)); /* two seeds: b has 26 */
    assert_true(v.mean == 23 && v.low == 20 && v.high == 26);
    assert_ok(c, scores_interval(c, s, &other, 1, SCORED_VIEW, METRIC_PSNR, &v));
    assert_true(v.mean == 1.5 && v.low == 0 && v.high == 3);
    scores_free_all(s, 2);
    scores_free(&other);
}

/* Two of person a, one of b: means are over all three, a person's mean is over their own. */
static void surfaces_of_a_file(void **state) {
    static const char text[] =
        "{\"images\": [], \"people\": [{\"person\": \"a\"}, {\"person\": \"b\"}, {\"person\": \"c\"}], "
        "\"surfaces\": {\"missed\": 2, \"each\": ["
        "{\"person\": \"a\", \"chamfer_cm\": 1, \"to_truth_cm\": 0.5, \"from_truth_cm\": 1.5, "
        "\"normal_deg\": 20, \"overlap\": 0.5}, "
        "{\"person\": \"b\", \"chamfer_cm\": 8, \"to_truth_cm\": 9, \"from_truth_cm\": 7, \"normal_deg\": "
        "50, \"overlap\": 0}, "
        "{\"person\": \"a\", \"chamfer_cm\": 3, \"to_truth_cm\": 2.5, \"from_truth_cm\": 3.5, "
        "\"normal_deg\": 26, \"overlap\": 1}]}}";
    static const double mean[] = {4, 4, 4, 32, 0.5}, low[] = {2, 1.5, 2.5, 23, 0},
                        high[] = {8, 9, 7, 50, 0.75};
    context *c = *state;
    const char *path = test_path("surfaces.json");
    char damaged[sizeof text];
    scores s;
    interval v;
    assert_ok(c, file_write(c, path, text, strlen(text)));
    assert_ok(c, scores_read(c, path, &s));
    assert_true(s.surfaces == 3 && s.surfaces_missed == 2);
    for (int m = PICTURE_METRICS; m < METRICS; m++) {
        assert_ok(c, scores_interval(c, &s, NULL, 1, SCORED_SURFACE, m, &v));
        assert_true(v.mean == mean[m - PICTURE_METRICS] && v.low == low[m - PICTURE_METRICS] &&
                    v.high == high[m - PICTURE_METRICS]);
    }
    scores_free(&s);
    memcpy(damaged, text, sizeof text);
    memcpy(strstr(damaged, "chamfer_cm"), "chanter_cm", 10);
    assert_ok(c, file_write(c, path, damaged, strlen(damaged)));
    assert_fails(c, scores_read(c, path, &s), SHERF_BAD_FILE, "surface without 'chamfer_cm'");
    memcpy(damaged, text, sizeof text);
    strstr(damaged, "each")[20] = 'x'; /* person a's name */
    assert_ok(c, file_write(c, path, damaged, strlen(damaged)));
    assert_fails(c, scores_read(c, path, &s), SHERF_BAD_FILE, "surface without a person");
}

static void other_files_are_refused(void **state) {
    context *c = *state;
    scores s;
    const char *path = test_path("other.json");
    assert_ok(c, file_write(c, path, "[1]", 3));
    assert_fails(c, scores_read(c, path, &s), SHERF_BAD_FILE, "other.json: not the scores of an evaluation");
    const char nobody[] = "{\"people\": [], \"images\": [{\"person\": \"x\"}]}";
    assert_ok(c, file_write(c, path, nobody, strlen(nobody)));
    assert_fails(c, scores_read(c, path, &s), SHERF_BAD_FILE, "a picture without person");
}

/* ---- pages ---- */
static void page_make(context *c, page *p) {
    *p = (page){.name = "main", .title = "A < B & C"};
    page_table *t = page_add_table(c, p, "50 %% of_it");
    assert_non_null(t);
    assert_ok(c, page_add_column(c, t, "view", "PSNR", 2, 1));
    assert_ok(c, page_add_column(c, t, "view", "LPIPS", 3, -1));
    assert_ok(
        c, page_add_column(c, t, "", "n", 0, 1)); /* only one row has it, so it is not marked as the best */
    const interval rows[2][3] = {{{20, 19.5, 20.5}, {0.2, NAN, NAN}, {4, NAN, NAN}},
                                 {{21, 20, 22}, {0.3, NAN, NAN}, {NAN, NAN, NAN}}};
    for (int i = 0; i < 2; i++) memcpy(page_add_row(c, t, "row %d", i)->value, rows[i], sizeof rows[i]);
    page_plot *q = page_add_plot(c, p, "lines", "Lines");
    snprintf(q->x, sizeof q->x, "degrees"), snprintf(q->y, sizeof q->y, "PSNR");
    page_series *s = page_add_series(c, q, "X & Y");
    assert_ok(c, page_add_point(c, s, 0, rows[0][0]));
    assert_ok(c, page_add_point(c, s, 30, rows[1][0]));
    assert_ok(c, page_add_note(c, p, "noted <once>"));
}

static void pages_are_written(void **state) {
    context *c = *state;
    page p;
    char folder[512];
    snprintf(folder, sizeof folder, "%s", test_path("page"));
    assert_ok(c, folder_make(c, folder));
    page_make(c, &p);
    assert_ok(c, page_write(c, &p, folder));
    char *md = text_of(c, folder, "table.md"), *tex = text_of(c, folder, "table.tex"),
         *html = text_of(c, folder, "index.html"), *json = text_of(c, folder, "results.json"),
         *svg = text_of(c, folder, "lines.svg");
    assert_in(md, "|  | view PSNR | view LPIPS | n |");
    assert_in(md, "| row 0 | 20.00 [19.50, 20.50] | **0.200** | 4 |");
    assert_in(md, "| row 1 | **21.00 [20.00, 22.00]** | 0.300 | - |");
    assert_in(tex, "\\multicolumn{2}{c}{view}");
    assert_in(tex, "row 1 & \\textbf{21.00 [20.00, 22.00]} & 0.300 & - \\\\");
    assert_in(tex, "50 \\% of\\_it");
    assert_in(html, "A &#60; B &#38; C");
    assert_in(html, "<img src=\"lines.svg\"");
    assert_in(html, "noted &#60;once&#62;");
    assert_in(svg, "X &#38; Y</text>");
    assert_in(json, "\"label\":\t\"row 1\"");
    mem_free(md), mem_free(tex), mem_free(html), mem_free(json), mem_free(svg);
    page_free(&p);
}

/* Running out of memory anywhere is reported, and leaves nothing behind. */
static void every_allocation_fails(void **state) {
    context *c = *state;
    page p;
    scores s;
    char folder[512];
    snprintf(folder, sizeof folder, "%s", test_path("no memory"));
    assert_ok(c, folder_make(c, folder));
    page_make(c, &p);
    scores_make(c, 24, &s);
    scores_free(&s);
    const char *path = test_path("scores.json");
    for (int what = 0; what < 2; what++) {
        const size_t live = mem_live();
        sherf_status status = SHERF_NO_MEMORY;
        for (long k = 0; status != SHERF_OK; k++) {
            mem_fail_after(k);
            status = what ? scores_read(c, path, &s) : page_write(c, &p, folder);
            mem_fail_after(-1);
            if (status == SHERF_OK && what) scores_free(&s);
            assert_true(status == SHERF_OK || status == SHERF_NO_MEMORY);
            assert_int_equal(mem_live(), live);
        }
    }
    page_free(&p);
}

/* Every error bar in the SVG ends at its interval's ends, at the axis's scale. */
static void error_bars_are_to_scale(void **state) {
    context *c = *state;
    page p;
    page_make(c, &p);
    char folder[512];
    snprintf(folder, sizeof folder, "%s", test_path("scale"));
    assert_ok(c, folder_make(c, folder));
    assert_ok(c, page_plot_write(c, &p.plot[0], folder));
    char *svg = text_of(c, folder, "lines.svg");
    double x[64][4];
    int bars = 0;
    for (const char *at = svg; (at = strstr(at, "<path d=\"M")) && bars < 64; at++) {
        char stroke[16] = "";
        double *b = x[bars];
        if (sscanf(at, "<path d=\"M%lf %lfL%lf %lf\" stroke=\"%15[^\"]\"", &b[0], &b[1], &b[2], &b[3],
                   stroke) == 5 &&
            !strcmp(stroke, "#1f3f7f") && b[0] == b[2])
            bars++;
    }
    assert_int_equal(bars, 2); /* of lengths 1 and 2 */
    assert_true(fabs(fabs(x[1][1] - x[1][3]) - 2 * fabs(x[0][1] - x[0][3])) < 0.3);
    mem_free(svg);
    page_free(&p);
}

static void canvas_letters(void **state) {
    context *c = *state;
    canvas p;
    int dark = 0;
    assert_ok(c, canvas_create(c, 20, 20, &p));
    canvas_text(&p, 15, 15, "i(", 0); /* text beyond the edge is clipped */
    canvas_text(&p, 0, 0, "1", 0);
    for (int i = 0; i < 15 * 20; i++) dark += !p.rgb[3 * i];
    assert_int_equal(dark, 8 * 9); /* rows 2 6 2 2 7 */
    canvas_free(&p);
}

/* ---- angles ---- */
static void angles_round_a_body(void **state) {
    context *c = *state;
    body_model *body;
    sherf_pose pose;
    sherf_camera from, to;
    double degrees;
    const float turn[3] = {0.3f, 0.9f, -0.2f};
    float joint[24][3];
    assert_ok(c, tubeman_create(c, &body));
    sherf_pose_identity(&pose);
    assert_ok(c, sherf_body_pose(c, body, &pose, NULL, joint[0]));
    const float *root = joint[0];
    sherf_camera_orbit(root, 2.4f, 0.2f, 0.4f, 0.8f, 64, 64, &from);
    for (int i = 0; i < 12; i++) {
        const float azimuth = 0.2f + (float)(i - 5) * (float)M_PI / 6 + 0.15f;
        sherf_camera_orbit(root, 2.6f, azimuth, -0.1f, 0.8f, 64, 64, &to);
        assert_ok(c, camera_angle(c, body, &pose, &from, &to, &degrees));
        assert_true(fabs(degrees - (30 * (i - 5) + 0.15 * 180 / M_PI)) < 0.01 ||
                    fabs(degrees + 360 - (30 * (i - 5) + 0.15 * 180 / M_PI)) < 0.01);
        assert_int_equal(angle_rounded(degrees), 30 * (i - 5));
    }
    /* The whole scene turned over: the axis turns with the body. */
    sherf_camera_orbit(root, 2.6f, 1.2f, -0.1f, 0.8f, 64, 64, &to);
    double before;
    float R[9];
    assert_ok(c, camera_angle(c, body, &pose, &from, &to, &before));
    rodrigues(turn, R);
    sherf_camera *const camera[2] = {&from, &to};
    for (int k = 0; k < 2; k++) { /* x_camera = C x = (C R^T) (R x) */
        const sherf_camera was = *camera[k];
        for (int i = 0; i < 9; i++) {
            camera[k]->R[i] = 0;
            for (int n = 0; n < 3; n++) camera[k]->R[i] += was.R[i / 3 * 3 + n] * R[i % 3 * 3 + n];
        }
    }
    memcpy(pose.R, R, sizeof R);
    assert_ok(c, camera_angle(c, body, &pose, &from, &to, &degrees));
    assert_true(fabs(degrees - before) < 1e-2);
    assert_int_equal(angle_rounded(-179), 180);
    assert_int_equal(angle_rounded(-166), 180);
    assert_int_equal(angle_rounded(-164), -150);
    sherf_body_free(body);
}

/* ---- disturbed bodies ---- */
static void disturbed_by_so_much(void **state) {
    enum { BODIES = 6 };
    context *c = *state;
    body_model *body;
    sherf_pose truth[BODIES], bent;
    sherf_camera camera[BODIES];
    assert_ok(c, tubeman_create(c, &body));
    for (int i = 0; i < BODIES; i++) {
        sherf_pose_identity(&truth[i]);
        for (int k = 3; k < 72; k++)
            truth[i].poses_rad[k] = (float)(0.2 * random_normal(3, (uint64_t)(72 * i + k)));
        sherf_camera_orbit((float[]){0, -0.27f, 0}, 2.5f, (float)i, 0.1f, 0.8f, 256, 256, &camera[i]);
    }
    double small, large;
    assert_ok(c, disturbance_for(c, body, BODIES, camera, truth, 20, &small));
    assert_ok(c, disturbance_for(c, body, BODIES, camera, truth, 70, &large));
    double sum = 0;
    for (int i = 0; i < BODIES; i++) {
        float was[24][3], is[24][3], seen[2][2];
        double a[24][3], b[24][3];
        assert_ok(c, disturbed_pose(c, &(disturbance){body, large}, &camera[i], &truth[i], &bent));
        assert_ok(c, sherf_body_pose(c, body, &truth[i], NULL, was[0]));
        assert_ok(c, sherf_body_pose(c, body, &bent, NULL, is[0]));
        camera_project(&camera[i], 1, was[0], seen[0], NULL);
        camera_project(&camera[i], 1, is[0], seen[1], NULL);
        assert_true(fabsf(seen[0][0] - seen[1][0]) < 0.02f && fabsf(seen[0][1] - seen[1][1]) < 0.02f);
        for (int k = 0; k < 72; k++)
            a[k / 3][k % 3] = (double)was[k / 3][k % 3], b[k / 3][k % 3] = (double)is[k / 3][k % 3];
        sum += 1000 * procrustes_distance(24, (const double(*)[3])b, (const double(*)[3])a) / BODIES;
    }
    assert_true(fabs(sum - 70) < 0.1);
    assert_true(small > 0.02 && small < large && large < 1);
    assert_ok(c, disturbed_pose(c, &(disturbance){body, 0}, &camera[0], &truth[0], &bent));
    assert_memory_equal(&bent, &truth[0], sizeof bent);
    sherf_body_free(body);
}

/* ---- the plan ---- */
static void the_plan_holds_together(void **state) {
    context *c = *state;
    const experiment *e;
    for (int i = 0; (e = experiment_at(i)); i++) {
        assert_ptr_equal(experiment_find(e->name), e);
        assert_non_null(e->report);
        for (int k = 0; k < EXPERIMENT_METHODS && e->method[k]; k++) {
            const experiment_method *method = experiment_method_find(e->method[k]);
            assert_non_null(method);
            for (int scale = 0; scale < SCALES; scale++) {
                model_config config;
                assert_ok(c, model_config_parse(c, method->preset[scale], &config));
                assert_int_equal(config.kind->one_pose, method->one_pose);
                assert_int_equal(model_recipe(&config) != NULL, method->own);
            }
        }
    }
    assert_null(experiment_find("dance"));
    assert_null(experiment_find(NULL));
}

/* A number of each of the paper's tables, at its place. */
static void published_numbers(void **state) {
    static const struct {
        const char *experiment, *group, *row;
        int metric;
        double value;
    } some[] = {{"main", "RenderPeople pose", "NHP", 0, 19.60},
                {"main", "HuMMan view", "MPS-NeRF", 2, .19},
                {"main", "THuman view", "SHERF", 2, .10},
                {"ablation", "novel pose", "point, pixel", 0, 23.73},
                {"fusion", "novel pose", "SIREN", 1, .84},
                {"front-view", "freely: pose", "NHP", 0, 19.17},
                {"cross-data", "novel view", "NHP", 0, 22.07},
                {"estimated-body", "estimated: pose", "SHERF", 2, .24},
                {"runtime", "frames a second", "SHERF", 0, 1.33}};
    context *c = *state;
    for (size_t i = 0; i < COUNT_OF(some); i++) {
        page p = {0};
        int found = 0;
        assert_ok(c, published_add(c, &p, some[i].experiment));
        for (int t = 0; t < p.tables; t++)
            for (int r = 0; r < p.table[t].rows; r++)
                for (int k = 0; k < p.table[t].columns; k++)
                    if (!strcmp(p.table[t].row[r].label, some[i].row) &&
                        !strcmp(p.table[t].column[k].group, some[i].group)) {
                        assert_true(p.table[t].row[r].value[k + some[i].metric].mean == some[i].value);
                        found = 1;
                        break;
                    }
        assert_true(found);
        page_free(&p);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(intervals_cover),         cmocka_unit_test(intervals_of_little),
        cmocka_unit_test(scores_of_a_file),        cmocka_unit_test(surfaces_of_a_file),
        cmocka_unit_test(other_files_are_refused), cmocka_unit_test(pages_are_written),
        cmocka_unit_test(every_allocation_fails),  cmocka_unit_test(error_bars_are_to_scale),
        cmocka_unit_test(canvas_letters),          cmocka_unit_test(angles_round_a_body),
        cmocka_unit_test(disturbed_by_so_much),    cmocka_unit_test(the_plan_holds_together),
        cmocka_unit_test(published_numbers),
    };
    return cmocka_run_group_tests(tests, test_open, test_close);
}
