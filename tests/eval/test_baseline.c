/* Tests of the baselines on a tube person: what they draw, and that sherf_eval scores exactly that. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "eval/metrics.h"
#include "eval/resnet50_file.h"
#include "eval/selection.h"
#include "eval/baseline.h"
#include "tube_people.h"

enum { SIDE = 96, PIXELS = SIDE * SIDE };
static char out[600];
static tube_people people;
static sherf_dataset *data;
static body_model *body;

static int make_data(void **state) {
    context *c = test_context();
    const char *root = test_path("people");
    *state = c;
    snprintf(out, sizeof out, "%s/out", root);
    const sherf_synth_options synth = {.people = 3, .poses = 2, .views = 6, .size_px = SIDE, .seed = 5};
    sherf_status status = tube_people_make(c, root, &synth, &people);
    if (!status) status = sherf_dataset_open(c, people.spec, &data);
    if (!status) status = body_load(c, people.body, &body);
    if (status) fprintf(stderr, "%s\n", c->message);
    return status != SHERF_OK;
}

static int free_data(void **state) {
    sherf_body_free(body);
    sherf_dataset_free(data);
    sherf_context_free(*state);
    return mem_live() != 0;
}

/* The observed picture is nearly reproduced. Seen from behind, the silhouette is right, and the colours are
 * guesses. */
static void painted_body_is_close_to_what_it_saw(void **state) {
    context *c = *state;
    data_view *seen, *behind;
    baselines y;
    static float rgb[3 * PIXELS];
    static uint8_t all[PIXELS];
    memset(all, 1, sizeof all);
    assert_ok(c, dataset_view(c, data, 0, 0, 1, 0, &seen));
    assert_ok(c, dataset_view(c, data, 0, 0, 4, 0, &behind));
    assert_ok(c, baselines_create(c, body, seen, &y));
    assert_ok(c, baseline_painted_body(c, &y, body, &seen->camera, &seen->pose, rgb));
    double again = metric_psnr(PIXELS, rgb, seen->image.data, all);
    assert_ok(c, baseline_painted_body(c, &y, body, &behind->camera, &behind->pose, rgb));
    double unseen = metric_psnr(PIXELS, rgb, behind->image.data, all);
    int outside = 0;
    for (int i = 0; i < PIXELS; i++) outside += !behind->mask[i] && rgb[3 * i + 1] > 0.5f;
    baseline_mean_color(&y, seen, rgb);
    double flat = metric_psnr(PIXELS, rgb, seen->image.data, all);
    printf("painted body: %.2f dB of the observed view, %.2f dB from behind; mean colour %.2f dB\n", again,
           unseen, flat);
    assert_true(again > 24 && again > flat + 3 && again > unseen && outside < 40);
    int count = 0, guessed = 0;
    for (int v = 0; v < body->vertices; v++) {
        count += y.seen[v];
        for (int k = 0; k < 3; k++) assert_true(y.color[3 * v + k] >= 0 && y.color[3 * v + k] <= 1);
        if (y.seen[v] || !y.seen[body->mirror[v]]) continue;
        assert_memory_equal(y.color + 3 * v, y.color + 3 * body->mirror[v], 3 * sizeof(float));
        guessed++;
    }
    assert_true(count > body->vertices / 5 && count < body->vertices * 3 / 5 && guessed > 0);
    baselines_free(&y);
    sherf_observation_free(seen);
    sherf_observation_free(behind);
}

static void mean_color_is_the_mean(void **state) {
    context *c = *state;
    data_view *seen, *target;
    baselines y;
    static float rgb[3 * PIXELS];
    double sum[3] = {0};
    int n = 0;
    assert_ok(c, dataset_view(c, data, 1, 1, 2, 0, &seen));
    assert_ok(c, dataset_view(c, data, 1, 0, 5, 0, &target));
    assert_ok(c, baselines_create(c, body, seen, &y));
    for (int i = 0; i < PIXELS; i++) {
        for (int k = 0; k < 3 && seen->mask[i]; k++) sum[k] += seen->image.data[3 * i + k];
        n += seen->mask[i];
    }
    baseline_mean_color(&y, target, rgb);
    for (int i = 0; i < 3 * PIXELS; i++)
        assert_true(fabs(rgb[i] - (target->mask[i / 3] ? sum[i % 3] / n : 0)) < 1e-6);
    baselines_free(&y);
    sherf_observation_free(seen);
    sherf_observation_free(target);
}

/* A file with random weights, and the network loaded from it. */
static resnet50_network *made_up_resnet50(context *c, const char *path) {
    safetensor_item item[2 * RESNET50_CONVOLUTIONS];
    char name[2 * RESNET50_CONVOLUTIONS][64];
    resnet50_network *n, *read;
    assert_ok(c, resnet50_create(c, &n));
    for (int i = 0; i < 2 * RESNET50_CONVOLUTIONS; i++) {
        const tensor *t = i % 2 ? n->bias[i / 2] : n->weight[i / 2];
        test_centred("baseline.resnet50", tensor_count(t), 2 / sqrt((double)(tensor_count(t) / t->dim[0])),
                     t->data);
        snprintf(name[i], sizeof name[i], "%s.%s", resnet50_layers[i / 2].name, i % 2 ? "bias" : "weight");
        item[i] = (safetensor_item){.name = name[i], .type = T_F32, .rank = t->rank, .data = t->data};
        memcpy(item[i].dim, t->dim, sizeof item[i].dim);
    }
    assert_ok(c, safetensors_write(c, path, COUNT_OF(item), item, 0, NULL));
    assert_ok(c, resnet50_load(c, path, &read));
    for (int i = 0; i < RESNET50_CONVOLUTIONS; i++)
        assert_memory_equal(n->weight[i]->data, read->weight[i]->data,
                            (size_t)tensor_count(n->weight[i]) * 4);
    resnet50_free(n);
    return read;
}

static double distance_of(context *c, const resnet50_network *n, const uint8_t *mask, const float *a,
                          const float *b) {
    rectangle r;
    static float crop[2][3 * PIXELS];
    assert_true(mask_bounds(mask, SIDE, SIDE, &r));
    masked_crop(a, mask, SIDE, r, crop[0]);
    masked_crop(b, mask, SIDE, r, crop[1]);
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu});
    const int64_t shape[3] = {r.height, r.width, 3};
    const tensor *d =
        resnet50_distance(t, n, tape_input(t, crop[0], 3, shape), tape_input(t, crop[1], 3, shape));
    assert_ok(c, tape_status(t));
    double distance = *tensor_f32(d);
    tape_free(t);
    return distance;
}

/* A baseline's recomputed PSNR and perceptual distance. */
static double psnr_of(context *c, const baselines *y, int person, int pose, int view, bool painted,
                      const resnet50_network *n, double *distance) {
    data_view *truth;
    posed_body *p;
    static float rgb[3 * PIXELS];
    static uint8_t mask[PIXELS];
    float low[3], high[3];
    assert_ok(c, dataset_view(c, data, person, pose, view, 0, &truth));
    if (painted)
        assert_ok(c, baseline_painted_body(c, y, body, &truth->camera, &truth->pose, rgb));
    else
        baseline_mean_color(y, truth, rgb);
    assert_ok(c, posed_body_create(c, body, truth->pose.poses_rad, truth->pose.shapes, truth->pose.R,
                                   truth->pose.Th_m, &p));
    body_world_box(body, p, low, high);
    box_ray_mask(&truth->camera, low, high, mask);
    double psnr = metric_psnr(PIXELS, rgb, truth->image.data, mask);
    *distance = distance_of(c, n, mask, rgb, truth->image.data);
    posed_body_free(p);
    sherf_observation_free(truth);
    return psnr;
}

static void scores_are_those_of_the_pictures(void **state) {
    context *c = *state;
    sherf_eval_options o = {.data = people.spec,
                            .people = "1",
                            .body = people.body,
                            .model = people.weights,
                            .observations = "1:2",
                            .poses = "0,1",
                            .views = "0,5",
                            .output = out,
                            .write_png = 1,
                            .baselines = 1};
    sherf_scores s;
    document *d;
    data_view *seen;
    baselines y;
    char path[700], file[512];
    snprintf(file, sizeof file, "%s", test_path("resnet50.safetensors"));
    resnet50_network *network = made_up_resnet50(c, file);
    o.perceptual = file;
    assert_ok(c, sherf_eval(c, &o, &s));
    assert_true(s.novel_view.resnet50 > 0 && s.novel_pose.resnet50 < 6 && isnan(s.novel_pose.lpips));
    assert_non_null(strstr(s.table, "painted body"));
    assert_non_null(strstr(s.table, "model's gain"));
    assert_int_equal(s.mean_color[0].count, 2);
    assert_int_equal(s.painted_body[1].count, 2);
    assert_ok(c, dataset_view(c, data, 1, 1, 2, 0, &seen));
    assert_ok(c, baselines_create(c, body, seen, &y));
    snprintf(path, sizeof path, "%s/scores.json", out);
    assert_ok(c, json_read(c, path, &d));
    const value *images = value_get(d->root, "images");
    assert_int_equal(value_count(images), 4);
    double sum[2][2] = {{0}};
    for (size_t i = 0; i < 4; i++) {
        const value *image = value_at(images, i);
        const int pose = (int)number(image, "pose"), view = (int)number(image, "view");
        for (int painted = 0; painted < 2; painted++) {
            const value *scored = value_get(image, painted ? "painted_body" : "mean_color");
            double psnr = number(scored, "psnr"), distance;
            assert_true(fabs(psnr - psnr_of(c, &y, 1, pose, view, painted, network, &distance)) < 1e-5);
            assert_true(distance > 0 && fabs(number(scored, "resnet50") - distance) < 1e-5 * distance);
            sum[painted][pose != 1] += psnr / 2;
        }
    }
    for (int pose = 0; pose < 2; pose++) {
        const char *kind = pose ? "novel_pose" : "novel_view";
        const sherf_score *model = pose ? &s.novel_pose : &s.novel_view;
        assert_true(fabs(s.mean_color[pose].psnr - sum[0][pose]) < 1e-6);
        assert_true(fabs(s.painted_body[pose].psnr - sum[1][pose]) < 1e-6);
        assert_true(fabs(number(value_get(value_get(d->root, "painted_body"), kind), "psnr") - sum[1][pose]) <
                    1e-6);
        double gain = number(value_get(value_get(d->root, "gain"), kind), "psnr");
        assert_true(fabs(gain - (model->psnr - fmax(sum[0][pose], sum[1][pose]))) < 1e-6);
    }
    document_free(d);
    baselines_free(&y);
    resnet50_free(network);
    sherf_observation_free(seen);
    sherf_free(s.table);
}

/* One observation of each person, chosen only by the seed and the person's name. */
static void random_observations(void **state) {
    context *c = *state;
    picture first[3];
    int others = 0;
    for (int seed = 0; seed < 8; seed++)
        for (int person = 0; person < 3; person++) {
            selection s, again;
            assert_ok(c, selection_create(c, data, person, "random", "0,1", "0,3", (uint64_t)seed, &s));
            assert_ok(c, selection_create(c, data, person, "random", "0,1", "0,3", (uint64_t)seed, &again));
            assert_int_equal(s.observations, 1);
            assert_memory_equal(s.observation, again.observation, sizeof *s.observation);
            assert_true(s.novel_pose[0] && s.observation->view >= 0 && s.observation->view < 6);
            if (!seed) first[person] = *s.observation;
            others += s.observation->pose != first[person].pose || s.observation->view != first[person].view;
            selection_free(&s);
            selection_free(&again);
        }
    assert_true(others > 10);
    sherf_eval_options o = {.data = people.spec,
                            .people = "0-2",
                            .body = people.body,
                            .model = people.weights,
                            .observations = "random",
                            .poses = "0,1",
                            .views = "0,3",
                            .size_px = 40,
                            .seed = 7};
    sherf_scores s;
    assert_ok(c, sherf_eval(c, &o, &s));
    assert_true(s.novel_pose.count == 6 && s.novel_view.count >= 3 && s.painted_body[0].count == 0);
    assert_null(strstr(s.table, "painted"));
    sherf_free(s.table);
    o.perceptual = people.body;
    assert_int_equal(sherf_eval(c, &o, &s), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "conv1.weight"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(painted_body_is_close_to_what_it_saw), cmocka_unit_test(mean_color_is_the_mean),
        cmocka_unit_test(scores_are_those_of_the_pictures), cmocka_unit_test(random_observations)};
    return cmocka_run_group_tests(tests, make_data, free_data);
}
