/* Tests of preference studies: intervals and strengths against known values, the page, the key, hostile
 * answers. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/path.h"
#include "experiment/study.h"
#include "study_page.h"
#include "support.h"

/* ---- numbers ---- */
static void wilson_and_binomial(void **state) {
    interval v = wilson(8, 10); /* values of the kind of Newcombe 1998's table: 0.4902, 0.9433 */
    assert_true(fabs(v.mean - 0.8) < 1e-12 && fabs(v.low - 0.490162) < 1e-5 &&
                fabs(v.high - 0.943318) < 1e-5);
    v = wilson(0, 20);
    assert_true(v.low >= -1e-12 && fabs(v.low) < 1e-12 && fabs(v.high - 0.161125) < 1e-5);
    assert_true(isnan(wilson(0, 0).mean));
    assert_true(fabs(binomial_p(8, 10) - 0.109375) < 1e-12); /* 2 (45 + 10 + 1) / 1024 */
    assert_true(fabs(binomial_p(2, 10) - 0.109375) < 1e-12);
    assert_true(binomial_p(5, 10) == 1 && isnan(binomial_p(0, 0)));
}

static void strengths_and_agreement(void **state) {
    const double wins[9] = {0, 29.5, 19.5, 9.5, 0, 0, 19.5, 0, 0}; /* 3 to 1, and 1 to 1 */
    double s[3];
    bradley_terry(3, wins, s);
    assert_true(fabs(s[0] / s[1] - 3) < 1e-6 && fabs(s[0] / s[2] - 1) < 1e-6);
    assert_true(fabs(s[0] + s[1] + s[2] - 1) < 1e-9);
    assert_true(fabs(fleiss_kappa(2, (int[]){5, 0, 0, 5}) - 1) < 1e-12);
    /* P = (1 + 1/3) / 2; shares 4/6: Pe = 5/9 */
    assert_true(fabs(fleiss_kappa(3, (int[]){3, 0, 1, 2, 1, 0}) - (2. / 3 - 5. / 9) / (4. / 9)) < 1e-12);
    assert_true(isnan(fleiss_kappa(1, (int[]){1, 0})));
}

/* ---- a small study ---- */
enum { PEOPLE = 2, PAIRS = 4 };
/* A study of two people, each against two methods, with a catch trial. */
static void small_study(context *c, study *s, study_picture picture[3]) {
    *s = (study){.people = PEOPLE, .methods = 3};
    s->person = mem_zero(c, PEOPLE, sizeof *s->person);
    s->trial = mem_zero(c, PAIRS + 1, sizeof *s->trial);
    for (int i = 0; i < PEOPLE; i++) snprintf(s->person[i], STUDY_NAME, "p%d", i);
    for (int i = 0; i < 3; i++) snprintf(s->method[i], STUDY_NAME, "m%d", i);
    for (int i = 0; i < PAIRS; i++)
        s->trial[s->trials++] = (study_trial){.person = i / 2,
                                              .stratum = i % STUDY_STRATA,
                                              .method = {i % 2 ? 1 + i / 2 : 0, i % 2 ? 0 : 1 + i / 2},
                                              .picture = {0, 1, 2}};
    s->trial[s->trials++] = (study_trial){.is_catch = true, .blurred = 1, .picture = {0, 1, 2}};
    for (int i = 0; i < 3; i++) {
        const uint8_t rgb[3] = {(uint8_t)(50 * i), 10, 200};
        assert_ok(c, png_to_memory(c, 1, 1, 3, rgb, 1, &picture[i].png, &picture[i].bytes));
    }
}

static const char *write_small(context *c, study *s) {
    static char folder[512];
    study_picture picture[3];
    snprintf(folder, sizeof folder, "%s", test_path("study"));
    assert_ok(c, folder_make(c, folder));
    small_study(c, s, picture);
    assert_ok(c, study_write(c, s, 3, picture, 7, folder));
    document *page = study_page(c, folder);
    for (size_t t = 0; t < (size_t)s->trials; t++)
        for (size_t i = 0; i < 3; i++) { /* every trial has these three pictures */
            size_t bytes;
            const unsigned char *png = study_png(page, t, i, &bytes);
            assert_int_equal(bytes, picture[i].bytes);
            assert_memory_equal(png, picture[i].png, bytes);
        }
    document_free(page);
    for (int i = 0; i < 3; i++) mem_free(picture[i].png);
    return folder;
}

static char *text_of(context *c, const char *folder, const char *name) {
    char path[700];
    unsigned char *text;
    size_t bytes;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    assert_ok(c, file_read(c, path, 1 << 24, &text, &bytes));
    return (char *)text;
}

/* The page contains the pictures and no method's or person's name; the key is read back unchanged. */
static void page_and_key(void **state) {
    context *c = test_context();
    study s, back;
    char path[700];
    const char *folder = write_small(c, &s);
    char *page = text_of(c, folder, "study.html");
    assert_non_null(strstr(page, s.id));
    assert_non_null(strstr(page, "data:image/png;base64,iVBORw0KGgo"));
    assert_non_null(strstr(page, "localStorage"));
    assert_null(strstr(page, "@STYLE@"));
    assert_null(strstr(page, "@STUDY@"));
    assert_null(strstr(page, "\"m1\""));
    assert_null(strstr(page, "\"p1\""));
    assert_null(strstr(page, "blurred"));
    assert_null(strstr(page, "http:"));
    assert_null(strstr(page, "https:"));
    mem_free(page);
    snprintf(path, sizeof path, "%s/key.json", folder);
    assert_ok(c, study_read_key(c, path, &back));
    assert_string_equal(back.id, s.id);
    assert_true(back.trials == PAIRS + 1 && back.people == PEOPLE && back.methods == 3);
    for (int i = 0; i < s.trials; i++) {
        assert_int_equal(back.trial[i].is_catch, s.trial[i].is_catch);
        assert_int_equal(back.trial[i].person, s.trial[i].person);
        assert_int_equal(back.trial[i].stratum, s.trial[i].stratum);
        assert_int_equal(back.trial[i].method[1], s.trial[i].method[1]);
    }
    study_free(&back);
    static const char *const bad[] = {
        "{}", "[1]", "{\"format\": \"sherf-preference-key\"}",
        ("{\"format\": \"sherf-preference-key\", \"study\": \"1\", \"methods\": "
         "[\"a\", \"b\"], \"people\": [\"p\"], \"trials\": [{\"person\": 1}]}")};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        assert_ok(c, file_write(c, path, bad[i], strlen(bad[i])));
        assert_fails(c, study_read_key(c, path, &back), SHERF_BAD_FILE, "key.json");
    }
    study_free(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* The blurred copy is much smoother, with the same mean. */
static void blurring(void **state) {
    enum { SIDE = 64 };
    context *c = test_context();
    static uint8_t data[SIDE * SIDE * 3];
    image_u8 from = {SIDE, SIDE, 3, data}, to;
    double sum[2] = {0}, steps[2] = {0};
    for (int i = 0; i < SIDE * SIDE * 3; i++)
        data[i] = (uint8_t)(255 * random_uniform(random_key(1, "t", 0), (uint64_t)i));
    assert_ok(c, study_blur(c, &from, &to));
    for (int i = 0; i + 3 < SIDE * SIDE * 3; i++) {
        sum[0] += data[i], sum[1] += to.data[i];
        steps[0] += abs(data[i] - data[i + 3]), steps[1] += abs(to.data[i] - to.data[i + 3]);
    }
    assert_true(fabs(sum[0] / sum[1] - 1) < 0.02 && steps[1] < 0.1 * steps[0]);
    mem_free(to.data);
    sherf_context_free(c);
}

/* ---- answers ---- */
static char answer_path[700];

static sherf_status read_text(context *c, const study *s, study_answers *a, const char *text) {
    assert_ok(c, file_write(c, answer_path, text, strlen(text)));
    return study_read_answers(c, s, answer_path, a);
}

/* A file with these answers of this rater. */
static const char *file_of(const study *s, const char *rater, const char *trials) {
    static char text[4096];
    snprintf(
        text, sizeof text,
        "{\"format\": \"sherf-preference-answers\", \"version\": 1, \"study\": \"%s\", \"rater\": \"%s\", "
        "\"consent\": true, \"trials\": [%s]}",
        s->id, rater, trials);
    return text;
}

#define ANSWER(trial, left, chose, repeat)                                                                   \
    "{\"trial\": " trial ", \"left\": \"" left "\", \"chose\": \"" chose                                     \
    "\", \"ms\": 900, \"repeat\": " repeat "}"

static void answers_are_read(void **state) {
    context *c = test_context();
    study s;
    study_answers a = {0};
    snprintf(answer_path, sizeof answer_path, "%s/answers.json", write_small(c, &s));
    assert_ok(c, read_text(c, &s, &a,
                           file_of(&s, "ab12",
                                   ANSWER("0", "a", "left", "false") "," ANSWER(
                                       "1", "b", "left", "false") "," ANSWER("0", "b", "right", "true"))));
    assert_ok(c, read_text(c, &s, &a, file_of(&s, "cd34", ANSWER("0", "a", "right", "false"))));
    assert_true(a.raters == 2 && a.votes == 4);
    assert_true(a.vote[0].chosen == 0 && a.vote[1].chosen == 1 && a.vote[2].chosen == 0 &&
                a.vote[3].chosen == 1);
    assert_true(a.vote[2].repeat && a.vote[3].rater == 1 && a.vote[1].ms == 900);
    study_answers_free(&a);
    study_free(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void hostile_answers_are_refused(void **state) {
    static const struct {
        const char *trials, *says;
    } bad[] = {
        {ANSWER("5", "a", "left", "false"), "answer 1 is not one of this study"},
        {ANSWER("-1", "a", "left", "false"), "answer 1 is not one of this study"},
        {ANSWER("1e9", "a", "left", "false"), "answer 1 is not one of this study"},
        {ANSWER("0", "c", "left", "false"), "answer 1 is not one of this study"},
        {ANSWER("0", "a", "middle", "false"), "answer 1 is not one of this study"},
        {ANSWER("0", "a", "left", "1"), "answer 1 is not one of this study"},
        {"7", "answer 1 is not one of this study"},
        {ANSWER("0", "a", "left", "true"), "trial 0 is repeated and was not there before"},
        {ANSWER("0", "a", "left", "false") "," ANSWER("0", "a", "left", "false"), "trial 0 comes twice"},
    };
    context *c = test_context();
    study s;
    study_answers a = {0};
    snprintf(answer_path, sizeof answer_path, "%s/answers.json", write_small(c, &s));
    assert_ok(c, read_text(c, &s, &a, file_of(&s, "first", ANSWER("0", "a", "left", "false"))));
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        assert_fails(c, read_text(c, &s, &a, file_of(&s, "other", bad[i].trials)), SHERF_BAD_FILE,
                     bad[i].says);
        assert_non_null(strstr(c->message, "answers.json"));
        assert_true(a.raters == 1 && a.votes == 1);
    }
    assert_fails(c, read_text(c, &s, &a, file_of(&s, "first", "")), SHERF_BAD_ARGUMENT, "rater first");
    assert_fails(c, read_text(c, &s, &a, file_of(&s, "../x", "")), SHERF_BAD_FILE, "no rater");
    assert_fails(c, read_text(c, &s, &a, file_of(&s, "", "")), SHERF_BAD_FILE, "no rater");
    assert_fails(c, read_text(c, &s, &a, "{"), SHERF_BAD_FILE, "answers.json");
    assert_fails(c, read_text(c, &s, &a, "[]"), SHERF_BAD_FILE, "not the answers of a study");
    char *text = strdup(file_of(&s, "other", ""));
    memcpy(strstr(text, "true"), "null", 4);
    assert_fails(c, read_text(c, &s, &a, text), SHERF_BAD_FILE, "not consented");
    memcpy(strstr(text, s.id), "0123", 4);
    assert_fails(c, read_text(c, &s, &a, text), SHERF_MISMATCH, "to another study");
    free(text);
    study_answers_free(&a);
    study_free(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Writing, and reading the key and answers, while memory runs out at each allocation in turn. */
static void memory_runs_out(void **state) {
    char key[700], folder[512];
    context *c = test_context();
    study s, back;
    snprintf(folder, sizeof folder, "%s", write_small(c, &s));
    snprintf(answer_path, sizeof answer_path, "%s/answers.json", folder);
    snprintf(key, sizeof key, "%s/key.json", folder);
    const char *text = file_of(&s, "ab12", ANSWER("0", "a", "left", "false"));
    assert_ok(c, file_write(c, answer_path, text, strlen(text)));
    study_free(&s);
    sherf_context_free(c);
    sherf_status status = SHERF_NO_MEMORY;
    for (long left = 0; status != SHERF_OK; left++) {
        study_picture picture[3];
        study_answers a = {0};
        c = test_context();
        small_study(c, &s, picture);
        mem_fail_after(left);
        status = study_write(c, &s, 3, picture, 7, folder);
        back = (study){0};
        if (status == SHERF_OK) status = study_read_key(c, key, &back);
        if (status == SHERF_OK) status = study_read_answers(c, &back, answer_path, &a);
        mem_fail_after(-1);
        assert_true(status == SHERF_OK || status == SHERF_NO_MEMORY);
        for (int i = 0; i < 3; i++) mem_free(picture[i].png);
        study_answers_free(&a);
        study_free(&back);
        study_free(&s);
        sherf_context_free(c);
        assert_int_equal(mem_live(), 0);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(wilson_and_binomial), cmocka_unit_test(strengths_and_agreement),
        cmocka_unit_test(page_and_key),        cmocka_unit_test(blurring),
        cmocka_unit_test(answers_are_read),    cmocka_unit_test(hostile_answers_are_refused),
        cmocka_unit_test(memory_runs_out),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
