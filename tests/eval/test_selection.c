#include <math.h>
#include <string.h>

#include "eval/report.h"
#include "support.h"

static void lists(void **state) {
    context *c = test_context();
    int *v, n;
    assert_ok(c, selection_list(c, "0,2,5", "views", 6, &v, &n));
    assert_int_equal(n, 3);
    assert_int_equal(v[2], 5);
    mem_free(v);
    assert_ok(c, selection_list(c, "1:3:4,0", "poses", 11, &v, &n));
    assert_int_equal(n, 5);
    assert_int_equal(v[3], 10);
    assert_int_equal(v[4], 0);
    mem_free(v);
    const char *bad[] = {"",      "a",   "1,",  ",1", "1 2",         "6",   "0:1:7",
                         "0:0:2", "0:1", "1,1", "-1", "99999999999", "0:1:"};
    for (size_t i = 0; i < COUNT_OF(bad); i++) {
        assert_int_equal(selection_list(c, bad[i], "views", 6, &v, &n), SHERF_BAD_ARGUMENT);
        assert_null(v);
    }
    picture *p;
    assert_ok(c, selection_pictures(c, "0:4,2:23", 3, 24, &p, &n));
    assert_true(n == 2 && p[1].pose == 2 && p[1].view == 23);
    mem_free(p);
    const char *wrong[] = {"", "0", "0:", ":4", "0:4,", "3:0", "0:24", "0:4:1", "0:4 ", "0:4,0:4"};
    for (size_t i = 0; i < COUNT_OF(wrong); i++)
        assert_int_equal(selection_pictures(c, wrong[i], 3, 24, &p, &n), SHERF_BAD_ARGUMENT);
    assert_int_equal(mem_live(), 1); /* the context */
    sherf_context_free(c);
}

static void targets(void **state) {
    bool novel_pose[] = {true, false};
    picture observation[] = {{0, 4}, {2, 4}};
    int pose[] = {0, 2}, view[] = {0, 2, 4};
    selection s = {.observations = 2,
                   .poses = 2,
                   .views = 3,
                   .observation = observation,
                   .novel_pose = novel_pose,
                   .pose = pose,
                   .view = view};
    bool novel;
    assert_false(selection_target(&s, 0, (picture){0, 4}, &novel)); /* the observed picture itself */
    assert_true(selection_target(&s, 0, (picture){0, 2}, &novel) && !novel);
    assert_true(selection_target(&s, 0, (picture){2, 4}, &novel) && novel);
    assert_false(selection_target(&s, 1, (picture){0, 4}, &novel));
    s.pictures = 3; /* of six views: 4, 0 and 2 */
    s.all_views = 6;
    assert_int_equal(selection_picture(&s, 0, 0).view, 4);
    assert_int_equal(selection_picture(&s, 0, 1).view, 0);
    assert_int_equal(selection_picture(&s, 1, 2).view, 2);
    assert_int_equal(selection_picture(&s, 1, 2).pose, 2);
    assert_false(selection_target(&s, 0, (picture){0, 2}, &novel));
    assert_true(selection_target(&s, 0, (picture){2, 2}, &novel) && novel);
    s.pictures = 1;
    assert_int_equal(selection_pairs(&s), 2 + 3 + 2);
}

static void means_over_views_first(void **state) {
    context *c = test_context();
    report r = {0};
    const double psnr[] = {10, 20, 40}; /* view 4: 10 and 20, view 7: 40 */
    for (int i = 0; i < 3; i++) {
        report_entry e = {.person = i == 0,
                          .observation = {0, i < 2 ? 4 : 7},
                          .score = {{.psnr = psnr[i], .ssim = .5, .lpips = NAN, .resnet50 = .25}}};
        assert_ok(c, report_add(c, &r, &e));
    }
    sherf_score s = report_mean(&r, SCORE_MODEL, -1, false);
    assert_true(fabs(s.psnr - 27.5) < 1e-12 && s.ssim == .5 && isnan(s.lpips) && s.resnet50 == .25 &&
                s.count == 3);
    s = report_mean(&r, SCORE_MODEL, 0, false);
    assert_true(fabs(s.psnr - 30) < 1e-12);
    s = report_mean(&r, SCORE_MODEL, -1, true);
    assert_true(isnan(s.psnr) && s.count == 0);
    r.plain_mean = true;
    s = report_mean(&r, SCORE_MODEL, -1, false);
    assert_true(fabs(s.psnr - 70. / 3) < 1e-12 && s.count == 3);
    report_free(&r);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(lists), cmocka_unit_test(targets),
                                       cmocka_unit_test(means_over_views_first)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
