/* Tests of estimated observations in samples: the targets are mapped to the estimate's world. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "train/loader.h"
#include "tube_training.h"

enum { SIDE = 48 };
static sherf_dataset *data;
static body_model *body;
static model_config config;

static int make_data(void **state) {
    context *c = test_context();
    const sherf_synth_options synth = {.people = 1, .poses = 2, .views = 4, .size_px = SIDE, .seed = 5};
    char path[1100];
    sherf_status status = tubes_make(c, &synth);
    snprintf(path, sizeof path, "%s/tubeman.safetensors", root);
    if (!status) status = body_load(c, path, &body);
    snprintf(path, sizeof path, "thuman:%s", root);
    if (!status) status = sherf_dataset_open(c, path, &data);
    if (!status) status = model_config_parse(c, TINY ",samples=16", &config);
    sherf_context_free(c);
    return status != SHERF_OK;
}

static int free_data(void **state) {
    sherf_dataset_free(data);
    sherf_body_free(body);
    return mem_live() != 0;
}

typedef enum { MOVED, NOBODY, NOWHERE } kind;

/* The truth in its own world, a quarter turn about y; or nobody; or a body outside the picture. */
static sherf_status estimate(context *c, void *state, const sherf_image *photo,
                             const sherf_observation *truth, sherf_observation **out) {
    static const float Q[9] = {0, 0, 1, 0, 1, 0, -1, 0, 0}, shift_m[3] = {1, -2, 0.5f};
    sherf_camera camera = truth->camera;
    sherf_pose pose = truth->pose;
    sherf_image mask = {SIDE, SIDE, 1, mem_alloc(c, SIDE * SIDE, sizeof(float))};
    assert_non_null(mask.data);
    assert_int_equal(photo->width, SIDE);
    *out = NULL;
    for (int i = 0; i < SIDE * SIDE; i++) mask.data[i] = truth->mask[i];
    for (int i = 0; i < 3; i++) {
        pose.Th_m[i] = shift_m[i];
        for (int k = 0; k < 3; k++) {
            pose.Th_m[i] += Q[3 * i + k] * truth->pose.Th_m[k];
            pose.R[3 * i + k] = camera.R[3 * i + k] = 0;
            for (int m = 0; m < 3; m++) {
                pose.R[3 * i + k] += Q[3 * i + m] * truth->pose.R[3 * m + k];
                camera.R[3 * i + k] += truth->camera.R[3 * i + m] * Q[3 * k + m];
            }
        }
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) camera.T_m[i] -= camera.R[3 * i + k] * shift_m[k];
    if (*(kind *)state == NOWHERE) pose.Th_m[0] += 50;
    sherf_status status = SHERF_OK;
    if (*(kind *)state != NOBODY)
        status = sherf_observation_create(c, &truth->image, &mask, &camera, &pose, out);
    sherf_image_free(&mask);
    return status;
}

static void load(context *c, kind what, bool estimated, sample *out) {
    const eval_estimator e = {estimate, &what};
    const sample_source from = {data, body, &config, &e, 0};
    const draw drawn = {.view = 2,
                        .observed_view = 1,
                        .estimated = estimated,
                        .further = 1,
                        .more = {{.pose = 1, .view = 3}},
                        .noise_key = 1};
    assert_ok(c, sample_load(c, &from, drawn, out));
}

/* The same rays meet the body, up to rounding. */
static void same_target(const target_geometry *a, const target_geometry *b) {
    const int64_t apart = a->points->count - b->points->count;
    assert_true(a->points->count > 500 && llabs(apart) * 100 < a->points->count);
}

static void targets_are_carried_over(void **state) {
    context *c = test_context();
    sample truth, moved;
    load(c, MOVED, false, &truth);
    load(c, MOVED, true, &moved);
    assert_true(fabsf(moved.observation->pose.Th_m[1] - truth.observation->pose.Th_m[1] + 2) < 1e-5f);
    same_target(truth.target_geometry, moved.target_geometry);
    same_target(truth.more[0].geometry, moved.more[0].geometry);
    assert_memory_equal(truth.target->image.data, moved.target->image.data, SIDE * SIDE * 3 * sizeof(float));
    sample_free(&truth);
    sample_free(&moved);
    sherf_context_free(c);
}

static void what_is_not_found_is_observed_as_it_is(void **state) {
    context *c = test_context();
    sample truth, other;
    load(c, MOVED, false, &truth);
    for (kind k = NOBODY; k <= NOWHERE; k++) {
        load(c, k, true, &other);
        assert_memory_equal(&truth.observation->camera, &other.observation->camera, sizeof(sherf_camera));
        assert_memory_equal(&truth.observation->pose, &other.observation->pose, sizeof(sherf_pose));
        assert_int_equal(truth.target_geometry->points->count, other.target_geometry->points->count);
        sample_free(&other);
    }
    sample_free(&truth);
    sherf_context_free(c);
}

static void a_share_is_estimated(void **state) {
    context *c = test_context();
    sampling s;
    assert_ok(c, sampling_create(c, data, "0", false, 1, 7, &s));
    static const double share[] = {0, 0.3, 1};
    for (size_t i = 0; i < COUNT_OF(share); i++) {
        int count = 0;
        s.estimated = share[i];
        for (int64_t n = 0; n < 2000; n++) {
            count += sampling_draw(&s, n).estimated;
            assert_int_equal(sampling_draw(&s, n).estimated, sampling_draw(&s, n).estimated);
        }
        assert_true(fabs(count / 2000. - share[i]) < (share[i] == 0.3 ? 0.04 : 1e-9));
    }
    sampling_free(&s);
    sherf_context_free(c);
}

/* One in two has several pictures, with 2 to N equally often. The views are distinct, and other draws do not
 * change. */
static void every_other_has_several_pictures(void **state) {
    context *c = test_context();
    sampling s;
    int count[5] = {0};
    assert_ok(c, sampling_create(c, data, "0", false, 1, 7, &s));
    for (int64_t n = 0; n < 2000; n++) {
        s.pictures = 1;
        const draw one = sampling_draw(&s, n);
        s.pictures = 8; /* the person has four views */
        const draw d = sampling_draw(&s, n);
        int seen = 1 << d.observed_view;
        assert_int_equal(one.also, 0);
        assert_true(d.also <= 3);
        assert_true(d.noise_key == one.noise_key && d.view == one.view &&
                    d.observed_view == one.observed_view);
        count[1 + d.also]++;
        for (int k = 0; k < d.also; k++) {
            assert_false(seen >> d.also_of[k].view & 1);
            seen |= 1 << d.also_of[k].view;
            assert_in_range(d.also_of[k].pose, 0, 1);
        }
    }
    assert_in_range(count[1], 920, 1080);
    for (int n = 2; n <= 4; n++) assert_in_range(count[n], 270, 400);
    s.estimated = 1;
    for (int64_t n = 0; n < 100; n++) assert_int_equal(sampling_draw(&s, n).also, 0);
    sampling_free(&s);
    sherf_context_free(c);
}

/* The encoders' picture is the one that an avatar of the same pictures reads. */
static void pictures_come_in_a_sheet(void **state) {
    context *c = test_context();
    const sample_source from = {data, body, &config, NULL, 0};
    const draw drawn = {.view = 2, .observed_view = 1, .also = 1, .also_of = {{1, 3}}, .noise_key = 1};
    data_view *view[2];
    observed_picture read[2];
    observed_sheet sheet;
    sample s;
    assert_ok(c, dataset_person_view(c, data, 0, 0, 1, 0, &view[0]));
    assert_ok(c, dataset_person_view(c, data, 0, 1, 3, 0, &view[1]));
    for (int k = 0; k < 2; k++) read[k] = (observed_picture){view[k]->image, view[k]->camera, view[k]->pose};
    assert_ok(c, observed_sheet_create(c, &config, body, 2, read, &sheet));
    assert_ok(c, sample_load(c, &from, drawn, &s));
    assert_int_equal(s.observation_geometry->width, sheet.width);
    assert_true(sheet.width > 2 * SIDE);
    assert_memory_equal(s.observation_geometry->image, sheet.image,
                        (size_t)sheet.width * (size_t)sheet.height * 3 * sizeof(float));
    assert_memory_equal(s.observation_geometry->body->R, sheet.body->R, sizeof sheet.body->R);
    assert_true(s.target_geometry->points->count > 500);
    sample_free(&s);
    observed_sheet_free(&sheet);
    for (int k = 0; k < 2; k++) sherf_observation_free(view[k]);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(targets_are_carried_over), cmocka_unit_test(what_is_not_found_is_observed_as_it_is),
        cmocka_unit_test(a_share_is_estimated), cmocka_unit_test(every_other_has_several_pictures),
        cmocka_unit_test(pictures_come_in_a_sheet)};
    return cmocka_run_group_tests(tests, make_data, free_data);
}
