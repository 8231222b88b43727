/* Tests of sherf_eval on two small tube people and a random model: which pictures are scored, and which files
 * are written. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/path.h"
#include "model/model.h"
#include "tube_people.h"

static char root[512];
static tube_people people;

static int make_data(void **state) {
    context *c = test_context();
    snprintf(root, sizeof root, "%s", test_path("people"));
    const sherf_synth_options synth = {
        .people = 2, .poses = 3, .views = 6, .size_px = 48, .seed = 5, .surfaces = 1};
    sherf_status status = tube_people_make(c, root, &synth, &people);
    sherf_context_free(c);
    return status != SHERF_OK;
}

/* PSNR of a written prediction, recomputed over the pixels whose rays cross the box. */
static double psnr_again(context *c, const sherf_dataset *d, const char *folder, const value *image) {
    char path[1200];
    const value *name = value_get(image, "rgb");
    assert_true(name && name->kind == VALUE_STRING);
    snprintf(path, sizeof path, "%s/%s", folder, name->string.text);
    document *npy;
    assert_ok(c, npy_read(c, path, &npy));
    const value *rgb = npy->root;
    assert_true(rgb->kind == VALUE_ARRAY && rgb->array.type == T_F32 && rgb->array.rank == 3);
    assert_true(rgb->array.dim[0] == 48 && rgb->array.dim[1] == 48 && rgb->array.dim[2] == 3);
    data_view *view;
    assert_ok(c, dataset_view(c, d, 0, (int)number(image, "pose"), (int)number(image, "view"), 0, &view));
    body_model *body;
    posed_body *p;
    assert_ok(c, body_load(c, people.body, &body));
    assert_ok(c, posed_body_create(c, body, view->pose.poses_rad, view->pose.shapes, view->pose.R,
                                   view->pose.Th_m, &p));
    float low[3], high[3];
    static uint8_t mask[48 * 48];
    body_world_box(body, p, low, high);
    box_ray_mask(&view->camera, low, high, mask);
    double sum = 0;
    int n = 0;
    for (int i = 0; i < 48 * 48; i++)
        for (int k = 0; mask[i] && k < 3; k++, n++)
            sum += pow(((const float *)rgb->array.data)[3 * i + k] - (double)view->image.data[3 * i + k], 2);
    posed_body_free(p);
    sherf_body_free(body);
    sherf_observation_free(view);
    document_free(npy);
    return -10 * log10(sum / n);
}

/* Options for person 0, observed in pose 0 and view 4, with these poses and views. */
static sherf_eval_options one_person(const char *poses, const char *views) {
    return (sherf_eval_options){.data = people.spec,
                                .people = "0",
                                .body = people.body,
                                .model = people.weights,
                                .observations = "0:4",
                                .poses = poses,
                                .views = views};
}

/* The surface that an avatar would be baked to is compared on request; that of an empty avatar counts as
 * missed. */
static void surfaces_on_request(void **state) {
    context *c = test_context();
    for (int dense = 0; dense < 2; dense++) {
        sherf_model *m;
        sherf_scores s;
        char path[700];
        snprintf(path, sizeof path, "%s/%s.safetensors", root, dense ? "dense" : "empty");
        assert_ok(c,
                  sherf_model_create(
                      c, "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16", 3, &m));
        *(float *)parameter_find(m->weights, "decoder.alpha_linear.bias")->value.data = dense ? 100 : -100;
        assert_ok(c, sherf_model_save(c, m, path));
        sherf_model_free(m);
        sherf_eval_options o = one_person("0", "0");
        o.model = path;
        assert_ok(c, sherf_eval(c, &o, &s));
        assert_int_equal(s.surfaces.count + s.surfaces.missed, 0);
        sherf_free(s.table);
        o.surfaces = 1;
        assert_ok(c, sherf_eval(c, &o, &s));
        assert_int_equal(s.surfaces.count, dense);
        assert_int_equal(s.surfaces.missed, !dense);
        if (dense && !(s.surfaces.chamfer_cm > 0.5 && s.surfaces.chamfer_cm < 6)) /* a shell of 5 cm */
            fail_msg("%g cm", s.surfaces.chamfer_cm);
        sherf_free(s.table);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void listed_pictures(void **state) {
    context *c = test_context();
    char folder[600], path[700];
    snprintf(folder, sizeof folder, "%s/out/listed", root);
    sherf_eval_options o = one_person("0,2", "0:2:3");
    o.output = folder, o.write_png = o.write_npy = 1;
    sherf_scores s;
    assert_ok(c, sherf_eval(c, &o, &s));
    assert_int_equal(s.novel_view.count, 2); /* views 0 and 2; 4 is observed */
    assert_int_equal(s.novel_pose.count, 3);
    assert_true(isnan(s.novel_view.lpips));
    assert_non_null(strstr(s.table, "novel pose"));
    assert_non_null(strstr(s.table, "mean"));
    assert_non_null(strstr(s.table, "\n  not seen "));
    document *d;
    sherf_dataset *data;
    snprintf(path, sizeof path, "%s/scores.json", folder);
    assert_ok(c, json_read(c, path, &d));
    assert_ok(c, sherf_dataset_open(c, people.spec, &data));
    const value *images = value_get(d->root, "images");
    assert_int_equal(value_count(images), 5);
    double psnr = 0, ssim = 0;
    for (size_t i = 0; i < 5; i++) {
        const value *image = value_at(images, i), *seen = value_get(image, "observation");
        assert_true(value_is_string(value_get(image, "person"), sherf_dataset_person(data, 0)));
        assert_true(value_at(seen, 0)->integer == 0 && value_at(seen, 1)->integer == 4);
        assert_true(value_get(image, "lpips")->kind == VALUE_NONE);
        assert_true(fabs(psnr_again(c, data, folder, image) - number(image, "psnr")) < 1e-4);
        snprintf(path, sizeof path, "%s/%s", folder, value_get(image, "png")->string.text);
        assert_true(path_is_file(path));
        if (number(image, "pose") != 0) psnr += number(image, "psnr") / 3, ssim += number(image, "ssim") / 3;
    }
    assert_true(fabs(s.novel_pose.psnr - psnr) < 1e-6 && fabs(s.novel_pose.ssim - ssim) < 1e-6);
    assert_true(fabs(number(value_get(d->root, "novel_pose"), "psnr") - psnr) < 1e-6);
    assert_int_equal(value_count(value_get(d->root, "people")), 1);
    const value *regions = value_get(value_get(d->root, "regions"), "novel_pose");
    const double seen = number(value_get(regions, "seen"), "pixels"),
                 hidden = number(value_get(regions, "not_seen"), "pixels"),
                 covered = number(value_get(regions, "covered"), "pixels");
    assert_true(seen > 0 && hidden > 0 && covered >= 0 && covered < hidden);
    assert_true(number(value_get(regions, "seen"), "psnr") > 3);
    document_free(d);
    sherf_dataset_free(data);
    sherf_free(s.table);
    sherf_context_free(c);
}

static double pixels_of(const document *d, const char *region) {
    return number(value_get(value_get(value_get(d->root, "regions"), "novel_pose"), region), "pixels");
}

/* Frames with detail come from pictures scaled for the network, as users make avatars. The paper's frames
 * come from unscaled pictures. */
static void detail_is_what_users_see(void **state) {
    static const char *const size[] = {"px_per_m=0", "px_per_m=40,image_size=32"};
    context *c = test_context();
    double psnr[2][2];
    for (int known = 0; known < 2; known++) {
        char preset[200], weights[600];
        sherf_model *m;
        snprintf(preset, sizeof preset,
                 "small,encoder_width=8,style_width=16,plane_resolution=16,channel_max=16,%s", size[known]);
        snprintf(weights, sizeof weights, "%s/size.safetensors", root);
        assert_ok(c, sherf_model_create(c, preset, 3, &m));
        assert_ok(c, sherf_model_save(c, m, weights));
        sherf_model_free(m);
        for (int detail = 0; detail < 2; detail++) {
            sherf_eval_options o = one_person("0", "0");
            o.model = weights;
            o.detail = detail ? SHERF_DETAIL_ON : SHERF_DETAIL_OFF;
            sherf_scores s;
            assert_ok(c, sherf_eval(c, &o, &s));
            psnr[known][detail] = s.novel_view.psnr;
            sherf_free(s.table);
        }
    }
    assert_true(psnr[0][0] == psnr[1][0]);
    assert_true(fabs(psnr[0][1] - psnr[1][1]) > 0.001);
    sherf_context_free(c);
}

/* Two pictures of the person: fewer targets, a different avatar, and more of the body is seen. */
static void several_pictures(void **state) {
    context *c = test_context();
    char folder[600], path[700];
    sherf_scores s[2];
    document *d[2];
    snprintf(folder, sizeof folder, "%s/out/several", root);
    snprintf(path, sizeof path, "%s/scores.json", folder);
    for (int i = 0; i < 2; i++) { /* view 4 of six, and view 1 on the other side */
        sherf_eval_options o = one_person("0,2", "0:1:4");
        o.pictures = i + 1, o.output = folder;
        assert_ok(c, sherf_eval(c, &o, &s[i]));
        assert_ok(c, json_read(c, path, &d[i]));
        sherf_free(s[i].table);
    }
    assert_int_equal(s[0].novel_view.count, 4);
    assert_int_equal(s[1].novel_view.count, 3);
    assert_int_equal(s[1].novel_pose.count, s[0].novel_pose.count);
    assert_null(value_get(d[0]->root, "pictures"));
    assert_true(number(d[1]->root, "pictures") == 2);
    assert_true(s[0].novel_pose.psnr != s[1].novel_pose.psnr);
    assert_true(pixels_of(d[1], "seen") > 1.2 * pixels_of(d[0], "seen"));
    assert_true(pixels_of(d[1], "not_seen") < pixels_of(d[0], "not_seen"));
    for (int i = 0; i < 2; i++) document_free(d[i]);
    sherf_context_free(c);
}

static float *copy_of_weights(const model *m) {
    float *copy = malloc((size_t)m->weights->total_floats * sizeof *copy);
    assert_non_null(copy);
    return memcpy(copy, m->weights->values, (size_t)m->weights->total_floats * sizeof *copy);
}

/* Compares the banks of two kinds of batch norm statistics, with unchanged weights. */
static bool banks_equal(context *c, const model *m, const body_model *body, const observation_geometry *g,
                        tape_options a, tape_options b) {
    tape *t[2] = {tape_create(c, a), tape_create(c, b)};
    model_bank bank[2];
    bool equal = true;
    for (int i = 0; i < 2; i++) assert_ok(c, model_encode(t[i], m, body, g, &bank[i]));
    for (int i = 0; i < bank[0].count; i++)
        equal &= !memcmp(bank[0].tensor[i]->data, bank[1].tensor[i]->data,
                         (size_t)tensor_count(bank[0].tensor[i]) * sizeof(float));
    for (int i = 0; i < 2; i++) tape_free(t[i]);
    return equal;
}

/* The statistics are those of a training step, and the weights do not change. */
static void batch_statistics_are_the_pictures(void **state) {
    context *c = test_context();
    sherf_dataset *data;
    sherf_observation *o;
    model *m;
    body_model *body;
    observation_geometry *g;
    assert_ok(c, sherf_dataset_open(c, people.spec, &data));
    assert_ok(c, dataset_observation(c, data, 0, 0, 4, 0, &o));
    assert_ok(c, model_load(c, people.weights, &m));
    assert_ok(c, body_load(c, people.body, &body));
    assert_ok(c,
              observation_geometry_create(c, &m->config, body, &o->image, &o->camera, &o->pose, false, &g));
    const tape_options running = {.backend = backend_of(c)},
                       batch = {.backend = backend_of(c), .batch_statistics = true},
                       training = {.backend = backend_of(c), .training = true};
    float *before = copy_of_weights(m);
    const size_t bytes = (size_t)m->weights->total_floats * sizeof *before;
    assert_true(banks_equal(c, m, body, g, batch, batch));
    assert_false(banks_equal(c, m, body, g, running, batch));
    assert_memory_equal(m->weights->values, before, bytes);
    assert_true(banks_equal(c, m, body, g, batch, training));
    assert_true(memcmp(m->weights->values, before, bytes) != 0); /* training updates the running statistics */
    free(before);
    observation_geometry_free(g);
    sherf_body_free(body);
    model_free(m);
    sherf_observation_free(o);
    sherf_dataset_free(data);
    sherf_context_free(c);
}

static double psnr_of(context *c, const sherf_eval_options *o) {
    sherf_scores s;
    assert_ok(c, sherf_eval(c, o, &s));
    sherf_free(s.table);
    return s.novel_view.psnr;
}

/* Scores as in the release: with batch statistics, and each picture's PSNR rounded to three decimals. */
static void scores_as_released(void **state) {
    context *c = test_context();
    sherf_eval_options o = one_person("0", "0");
    const double psnr = psnr_of(c, &o);
    o.round_psnr = 1;
    assert_true(psnr_of(c, &o) == rint(psnr * 1000) / 1000);
    assert_true(psnr != rint(psnr * 1000) / 1000);
    o.round_psnr = 0;
    o.batch_statistics = 1;
    assert_true(fabs(psnr_of(c, &o) - psnr) > 1e-4);
    sherf_context_free(c);
}

/* Of THuman's protocol these people have poses 0 and 2, views 0, 2 and 4, and the observed view 4. */
static void the_protocol_as_far_as_it_goes(void **state) {
    context *c = test_context();
    sherf_eval_options o = {
        .data = people.spec, .people = "0-1", .body = people.body, .model = people.weights};
    sherf_scores s;
    assert_ok(c, sherf_eval(c, &o, &s));
    assert_int_equal(s.novel_view.count, 2 * 2 * 2); /* people x poses x views without the observed one */
    assert_int_equal(s.novel_pose.count, 2 * 3);
    sherf_free(s.table);
    sherf_context_free(c);
}

static void keep_warning(void *user, sherf_log_level level, const char *text) {
    if (level == SHERF_LOG_WARNING) snprintf(user, 1000, "%s", text);
}

/* Scores with another body than the data's would say little. */
static void another_body_is_named(void **state) {
    static char line[1000];
    context *c = test_context();
    sherf_eval_options o = one_person("0", "0");
    sherf_scores s;
    c->log = keep_warning, c->user = line;
    for (int other = 0; other < 2; other++) {
        if (other) o.body = "../assets/body.safetensors";
        *line = 0;
        assert_ok(c, sherf_eval(c, &o, &s));
        if (other ? !strstr(line, "has 6890: the poses are another body's") : *line) fail_msg("\"%s\"", line);
        sherf_free(s.table);
    }
    sherf_context_free(c);
}

static void mistakes_are_one_line(void **state) {
    context *c = test_context();
    const sherf_eval_options good = one_person("0", "0");
    sherf_scores s;
    size_t live = mem_live();
    sherf_eval_options o = good;
    o.people = "nobody";
    assert_int_not_equal(sherf_eval(c, &o, &s), SHERF_OK);
    o = good, o.observations = "0:6";
    assert_int_equal(sherf_eval(c, &o, &s), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "views 0 to 5"));
    o = good, o.views = "6";
    assert_int_equal(sherf_eval(c, &o, &s), SHERF_BAD_ARGUMENT);
    o = good, o.views = "4";
    assert_int_equal(sherf_eval(c, &o, &s), SHERF_BAD_ARGUMENT); /* only the observed one */
    o = good, o.model = people.body;
    assert_int_not_equal(sherf_eval(c, &o, &s), SHERF_OK);
    o = good, o.lpips = people.weights;
    assert_int_equal(sherf_eval(c, &o, &s), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "VGG16"));
    o = good, o.output = "/dev/null/out";
    assert_int_equal(sherf_eval(c, &o, &s), SHERF_WRITE_FAILED);
    assert_null(s.table);
    assert_int_equal(mem_live(), live);
    sherf_context_free(c);
}

/* Weights ruined by a training. */
static void weights_are_finite(void **state) {
    context *c = test_context();
    char path[700];
    sherf_model *m;
    unsigned char *data;
    size_t bytes;
    snprintf(path, sizeof path, "%s/nan.safetensors", root);
    assert_ok(c, file_read(c, people.weights, (size_t)1 << 30, &data, &bytes));
    memset(data + bytes - 64, 0xff, 4);
    unsigned char *sum =
        memmem(data, bytes, "\"crc32\"", 7); /* the checksum of the old contents gets another key */
    assert_non_null(sum);
    sum[1] = 'x';
    FILE *f = fopen(path, "wb");
    assert_int_equal(fwrite(data, 1, bytes, f), bytes);
    fclose(f);
    mem_free(data);
    assert_int_equal(sherf_model_load(c, path, &m), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, "not finite"));
    assert_null(m);
    sherf_context_free(c);
}

/* A person who cannot be read is reported with the file's name, and no empty folder remains. */
static void broken_people_are_named(void **state) {
    context *c = test_context();
    char folder[600], path[800], broken[700], broken_spec[720];
    snprintf(broken, sizeof broken, "%s/broken", root);
    snprintf(broken_spec, sizeof broken_spec, "thuman:%s", broken);
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 2, .size_px = 48, .seed = 6};
    assert_ok(c, sherf_synth_tube(c, broken, &synth));
    snprintf(folder, sizeof folder, "%s/out_broken", root);
    sherf_eval_options o = one_person("0", "1");
    o.data = broken_spec, o.observations = "0:0", o.output = folder;
    sherf_scores scores;
    static uint8_t corner[48 * 48] = {1}; /* a mask away from the body */
    snprintf(path, sizeof path, "%s/tube_000/mask_cihp/view00/000000.png", broken);
    assert_ok(c, png_write(c, path, 48, 48, 1, corner));
    assert_int_equal(sherf_eval(c, &o, &scores), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "tube_000, pose 0, view 0: no part of the body"));
    assert_false(path_is_folder(folder));
    static uint8_t kept[48 * 48], fill[48 * 48];
    for (int i = 0; i < 48 * 48; i++) kept[i] = i % 48 > 15 && i % 48 < 32; /* where the person stands */
    assert_ok(c, png_write(c, path, 48, 48, 1, kept));
    for (int full = 0; full < 2; full++) { /* the mask of a target picture */
        snprintf(path, sizeof path, "%s/tube_000/mask_cihp/view01/000000.png", broken);
        memset(fill, full ? 255 : 0, sizeof fill);
        assert_ok(c, png_write(c, path, 48, 48, 1, fill));
        assert_int_equal(sherf_eval(c, &o, &scores), SHERF_BAD_ARGUMENT);
        assert_non_null(strstr(c->message, "view01/000000.png: the mask "));
        assert_false(path_is_folder(folder));
    }
    assert_ok(c, png_write(c, path, 48, 48, 1, kept));
    snprintf(path, sizeof path, "%s/tube_000/view00/000000.png", broken);
    assert_int_equal(unlink(path), 0);
    assert_int_equal(sherf_eval(c, &o, &scores), SHERF_NO_FILE);
    assert_non_null(strstr(c->message, "view00/000000.png"));
    assert_false(path_is_folder(folder));
    snprintf(path, sizeof path, "%s/tube_000/annots.npy", broken);
    assert_int_equal(truncate(path, 200), 0);
    assert_int_equal(sherf_eval(c, &o, &scores), SHERF_BAD_FILE);
    assert_non_null(strstr(c->message, path));
    assert_false(path_is_folder(folder));
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(broken_people_are_named),
                                       cmocka_unit_test(weights_are_finite),
                                       cmocka_unit_test(surfaces_on_request),
                                       cmocka_unit_test(listed_pictures),
                                       cmocka_unit_test(detail_is_what_users_see),
                                       cmocka_unit_test(several_pictures),
                                       cmocka_unit_test(batch_statistics_are_the_pictures),
                                       cmocka_unit_test(scores_as_released),
                                       cmocka_unit_test(the_protocol_as_far_as_it_goes),
                                       cmocka_unit_test(another_body_is_named),
                                       cmocka_unit_test(mistakes_are_one_line)};
    return cmocka_run_group_tests(tests, make_data, NULL);
}
