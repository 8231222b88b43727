/* Tests of which pictures are scored: lists, targets, means. */
#include <math.h>
#include <string.h>

#include "data/dataset.h"
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
    s.pictures = 3; /* views 4, 0 and 2 of six */
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

/* One person with this many poses and views, without reading any files. */
static void protocol_of(context *c, const dataset_reader *reader, int poses, int views, selection *s) {
    person_record record = {.poses = poses, .views = views}, *records[] = {&record};
    char *names[] = {"somebody"};
    record_cache cache = {.record = records};
    const sherf_dataset d = {
        .reader = reader, .root = "nowhere", .people = 1, .name = names, .cache = &cache};
    pthread_mutex_init(&cache.lock, NULL);
    assert_ok(c, selection_create(c, &d, 0, NULL, NULL, NULL, 0, s));
    pthread_mutex_destroy(&cache.lock);
}

/* The poses of all targets of one kind, without repetition and in order. */
static int poses_of(const selection *s, bool novel_pose, int out[64]) {
    int n = 0;
    for (int p = 0; p < 1000; p++)
        for (int i = 0; i < s->observations; i++) {
            bool listed = false, novel;
            for (int k = 0; k < s->poses; k++) listed |= s->pose[k] == p;
            if (!listed || !selection_target(s, i, (picture){p, 1}, &novel) || novel != novel_pose) continue;
            out[n++] = p;
            break;
        }
    return n;
}

/* As in the release, novel poses come after the observed one, which is a later one in RenderPeople. */
static void poses_of_the_protocols(void **state) {
    static const struct {
        const dataset_reader *reader;
        int views, first, step, count, novel_first, novel_count, from;
        int64_t pairs; /* targets: poses x observed views x views, minus the observed ones in novel view */
    } all[] = {
        {&dataset_thuman, 24, 0, 2, 5, 2, 4, 0, 5 * 3 * 11 + 4 * 3 * 12},
        {&dataset_renderpeople, 36, 0, 2, 5, 4, 4, 2, 5 * (17 + 17 + 18) + 4 * 3 * 18},
        {&dataset_zju_mocap, 20, 0, 20, 25, 20, 24, 0, 25 * 3 * 9 + 24 * 3 * 10},
        {&dataset_humman, 10, 0, 6, 17, 6, 16, 0, 17 * 3 * 9 + 16 * 3 * 10},
    };
    context *c = test_context();
    for (size_t k = 0; k < COUNT_OF(all); k++) {
        selection s;
        int pose[64];
        protocol_of(c, all[k].reader, 500, all[k].views, &s);
        assert_int_equal(poses_of(&s, false, pose), all[k].count);
        for (int i = 0; i < all[k].count; i++) assert_int_equal(pose[i], all[k].first + i * all[k].step);
        assert_int_equal(poses_of(&s, true, pose), all[k].novel_count);
        for (int i = 0; i < all[k].novel_count; i++)
            assert_int_equal(pose[i], all[k].novel_first + i * all[k].step);
        for (int i = 0; i < s.observations; i++)
            assert_true(s.novel_pose[i] == (s.observation[i].pose == all[k].from));
        assert_int_equal(selection_pairs(&s), all[k].pairs);
        selection_free(&s);
    }
    selection s;
    int pose[64];
    protocol_of(c, &dataset_renderpeople, 10, 36, &s); /* no pose 10 */
    assert_int_equal(poses_of(&s, true, pose), 3);
    assert_int_equal(pose[2], 8);
    selection_free(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
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
                                       cmocka_unit_test(poses_of_the_protocols),
                                       cmocka_unit_test(means_over_views_first)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
