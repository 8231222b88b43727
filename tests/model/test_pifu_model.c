/* Tests of PIFu as a model: where it reads a picture, what it learns about surfaces, the avatars made with
 * it, and what they cannot do. test_pifu.c tests its networks. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/path.h"
#include "data/data.h"
#include "model/pifu/settings.h"
#include "rival.h"

#define TINY                                                                                                 \
    "stacks=2,width=32,color_width=8,hidden0=48,hidden1=24,hidden2=0,side_px=64,points=512,resolution=64"
static const char tiny[] = "pifu:own-small," TINY;

static void counts_are_those_of_the_paper(void **state) {
    /* 14,404,224 + 1,183,874 + 9,139,398: docs/rivals.md */
    static const rival_count known[] = {{"pifu:own", 24727496}, {"pifu:own-small", 3977192}};
    rival_counts(COUNT_OF(known), known);
}

static void settings_that_do_not_go_together(void **state) {
    context *c = test_context();
    model_config config;
    assert_fails(c, model_config_parse(c, "pifu:own,hidden1=0", &config), SHERF_BAD_ARGUMENT,
                 "hidden2: the layers end before it");
    assert_fails(c, model_config_parse(c, "pifu:own,resolution=96", &config), SHERF_BAD_ARGUMENT,
                 "powers of two");
    sherf_context_free(c);
}

/* ---- where it reads ---- */
static double height_of(const sherf_body *body, const posed_body *p) {
    double low = INFINITY, high = -INFINITY;
    for (int v = 0; v < body->vertices; v++) {
        const double y = (double)(body->v_template[3 * v + 1] + p->shape_offset[3 * v + 1]);
        low = fmin(low, y);
        high = fmax(high, y);
    }
    return high - low;
}

/* The whole body is in the square, and the square shows the picture. Steps along the camera's x and in depth
 * have the same relative scale for everybody. */
static void the_square_is_about_the_person(void **state) {
    context *c = test_context();
    model_config config;
    rival_scene s;
    assert_ok(c, model_config_parse(c, tiny, &config));
    rival_scene_open(c, &config, 0, 8, &s);
    const pifu_crop *crop = s.geometry->own;
    const int64_t n = s.body->vertices;
    float *world = malloc(6 * (size_t)n * sizeof *world), *uv = world + 3 * n, *z = world + 5 * n;
    uint8_t *in = malloc((size_t)n);
    body_vertices_world(s.body, s.geometry->body, world);
    pifu_crop_place(crop, &s.camera, n, world, uv, z, in);
    float low = 1, high = -1;
    for (int64_t i = 0; i < n; i++) {
        assert_true(in[i]);
        low = fminf(low, uv[2 * i + 1]);
        high = fmaxf(high, uv[2 * i + 1]);
    }
    assert_true(high - low > 1.2f && high - low < 1.93f && fabsf(high + low) < 0.02f);
    /* the tube person may hold the arms down or raised: the square is made for its height or a little more */
    const double height = height_of(s.body, s.geometry->body);
    assert_true((double)crop->height_m > 0.999 * height && (double)crop->height_m < 1.3 * height);
    /* a point ten centimetres to the right of the square's middle and ten behind it */
    float three[9];
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            three[3 * i + k] = crop->middle[k] + (i ? 0.1f * s.camera.R[(i == 1 ? 0 : 6) + k] : 0);
    pifu_crop_place(crop, &s.camera, 3, three, uv, z, in);
    assert_true(fabsf(uv[0]) < 1e-4f && fabsf(uv[1]) < 1e-4f && fabsf(z[0]) < 1e-4f);
    assert_true(fabs((double)uv[2] - 0.1 * 2 * 0.88 / (double)crop->height_m) < 2e-3);
    assert_true(fabs((double)z[2] - 10 * 0.1 * 2.25 / (double)crop->height_m) < 1e-3 && fabsf(z[1]) < 1e-4f);
    /* here the square's pixels are smaller than the picture's, so each has the value that the picture has
     * there */
    rival_map image = rival_image(s.observation, 2, -1);
    double worst = 0, spread = 0;
    for (int y = 1; y + 1 < crop->side; y++)
        for (int x = 1; x + 1 < crop->side; x++) {
            double want[3];
            const double step = (double)crop->side_px / (crop->side - 1),
                         u = (double)crop->left_px + x * step, v = (double)crop->top_px + y * step;
            if (u < 0 || v < 0 || u > image.width - 1 || v > image.height - 1) continue;
            rival_bilinear(image, u, v, want);
            worst = fmax(worst, fabs(want[1] - (double)crop->image[3 * (y * crop->side + x) + 1]));
            spread = fmax(spread, want[1]);
        }
    assert_true(worst < 1e-4 && spread > 0);
    free(image.v);
    free(world);
    free(in);
    rival_scene_close(&s);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* ---- training ---- */
enum { STEPS = 80 };

static void trained(context *c, sherf_model **m) {
    static bool done;
    static char path[700];
    if (!done) {
        double loss[STEPS], first = 0, last = 0;
        rival_losses(c, tiny, "learned", STEPS, loss);
        for (int i = 0; i < STEPS / 10; i++) first += loss[i], last += loss[STEPS - 1 - i];
        print_message("loss %g, then %g\n", 10 * first / STEPS, 10 * last / STEPS);
        assert_true(last < 0.75 * first);
        snprintf(path, sizeof path, "%s", rival_file("learned/model.safetensors"));
        done = true;
    }
    assert_ok(c, sherf_model_load(c, path, m));
}

static double overlap(const sherf_observation *o, const sherf_frame *f) {
    double both = 0, any = 0;
    for (int i = 0; i < o->image.width * o->image.height; i++) {
        const bool a = o->mask[i], b = f->opacity.data[i] >= 0.5f;
        both += a && b;
        any += a || b;
    }
    return both / any;
}

/* From the observed camera the surface has the mask's outline; read from a file it is the same. */
static void it_learns_what_is_inside(void **state) {
    context *c = test_context();
    sherf_model *m;
    sherf_body *body;
    sherf_observation *o;
    sherf_avatar *a;
    sherf_frame frame[2] = {0};
    const sherf_render_options plain = {
        .exact = 1, .detail = SHERF_DETAIL_OFF, .background = {0.5f, 0.25f, 1}};
    trained(c, &m);
    rival_observation(c, 0, 0, &body, &o);
    assert_ok(c, sherf_avatar_create(c, m, body, o, &a));
    const sherf_camera *camera = sherf_observation_camera(o);
    assert_ok(c, sherf_render(c, a, body, sherf_observation_pose(o), camera, &plain, &frame[0]));
    const double same = overlap(o, &frame[0]);
    print_message("outline: %.3f of the mask and it\n", same);
    assert_true(same > 0.6);
    for (int k = 0; k < 3; k++) assert_true(frame[0].color.data[k] == plain.background[k]);
    const char *path = rival_file("learned.safetensors");
    assert_ok(c, sherf_avatar_save(c, a, path));
    sherf_avatar_free(a);
    assert_ok(c, sherf_avatar_load(c, path, body, &a));
    assert_ok(c, sherf_render(c, a, body, sherf_observation_pose(o), camera, &plain, &frame[1]));
    const size_t n = (size_t)camera->width_px * (size_t)camera->height_px;
    assert_memory_equal(frame[0].color.data, frame[1].color.data, 3 * n * sizeof(float));
    assert_memory_equal(frame[0].depth.data, frame[1].depth.data, n * sizeof(float));
    for (int i = 0; i < 2; i++) sherf_frame_free(&frame[i]);
    sherf_avatar_free(a);
    sherf_observation_free(o);
    sherf_body_free(body);
    sherf_model_free(m);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* The coarse-to-fine search finds what querying everywhere finds. */
static void coarse_to_fine(void **state) {
    context *c = test_context();
    sherf_model *m;
    rival_scene s;
    kept_bank kept[2] = {{0}, {0}};
    trained(c, &m);
    rival_scene_open(c, &m->config, 0, 8, &s);
    tape *t = tape_create(c, (tape_options){.backend = backend_of(c)});
    pifu_settings *k = (pifu_settings *)m->config.own.bytes;
    for (int i = 0; i < 2; i++) {
        model_bank bank;
        tape_reset(t);
        k->resolution = 128;
        k->coarse = i ? 128 : 64;
        assert_ok(c, model_encode(t, m, s.body, s.geometry, &bank));
        assert_ok(c, kept_make(c, m, s.geometry, &bank, &kept[i]));
    }
    const int64_t vertices = kept[1].array[PIFU_VERTICES].dim[0];
    print_message("%lld vertices, %lld of all points\n", (long long)kept[0].array[PIFU_VERTICES].dim[0],
                  (long long)vertices);
    assert_true(vertices > 500);
    assert_true(fabs((double)(kept[0].array[PIFU_VERTICES].dim[0] - vertices)) < 0.02 * (double)vertices);
    for (int i = 0; i < 2; i++) kept_free(&kept[i]);
    tape_free(t);
    rival_scene_close(&s);
    sherf_model_free(m);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void it_goes_on_with_the_same_bits(void **state) {
    rival_goes_on(tiny);
}

/* ---- what it cannot do, and damaged files ---- */
static void one_line(void **state) {
    context *c = test_context();
    sherf_body *body;
    sherf_avatar *a;
    sherf_frame f = {0};
    const char *path = rival_avatar(c, tiny, &body);
    assert_ok(c, sherf_avatar_load(c, path, body, &a));
    sherf_pose pose = *sherf_avatar_pose(a);
    pose.poses_rad[3] += 0.1f;
    assert_fails(c, sherf_render(c, a, body, &pose, sherf_avatar_camera(a), NULL, &f), SHERF_UNSUPPORTED,
                 "model pifu has no canonical space");
    const sherf_export_options options = {0};
    assert_fails(c, sherf_export(c, a, body, &options, test_path("a.glb"), NULL), SHERF_UNSUPPORTED,
                 "model pifu has no canonical space");
    sherf_frame_free(&f);
    sherf_avatar_free(a);
    sherf_body_free(body);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void trainings_that_are_refused(void **state) {
    context *c = test_context();
    const char *plain = test_path("plain");
    char data[700], without[700], body[700], output[700];
    const sherf_synth_options synth = {.people = 1, .poses = 1, .views = 2, .size_px = 32, .seed = 5};
    assert_ok(c, sherf_synth_tube(c, plain, &synth));
    snprintf(without, sizeof without, "thuman:%s", plain);
    snprintf(data, sizeof data, "thuman:%s", rival_file(""));
    snprintf(body, sizeof body, "%s", rival_file("tubeman.safetensors"));
    snprintf(output, sizeof output, "%s", test_path("refused"));
    sherf_train_options o = {
        .data = without, .people = "0-0", .body = body, .output = output, .preset = tiny, .steps = 1};
    assert_fails(c, sherf_train(c, &o), SHERF_NO_FILE, "surface/0.safetensors: not there");
    o.data = data;
    o.targets = 2;
    assert_fails(c, sherf_train(c, &o), SHERF_BAD_ARGUMENT, "learns from surfaces");
    o.targets = 0;
    o.pictures = 2;
    assert_fails(c, sherf_train(c, &o), SHERF_UNSUPPORTED, "a pifu takes one picture");
    o.pictures = 0;
    o.estimated = 0.5;
    assert_fails(c, sherf_train(c, &o), SHERF_UNSUPPORTED, "learns from surfaces");
    assert_false(path_is_folder(output));
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Avatar files whose arrays do not match each other. */
static void damaged_avatars(void **state) {
    static const struct {
        int array, what;
        const char *says;
    } cases[] = {{PIFU_TRIANGLES, 0, "a triangle has a corner that is not there"},
                 {PIFU_VERTICES, 1, "is not finite"},
                 {PIFU_COLORS, 1, "is not finite"},
                 {PIFU_COLORS, 2, "1 vertices and 2 colours"}};
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(cases); i++) {
        model_config config;
        float vertex[3] = {0, 0, 2}, color[6] = {0};
        int32_t triangle[3] = {0};
        void *field;
        assert_ok(c, model_config_parse(c, tiny, &config));
        kept_bank kept;
        config.kind->kept(&config, &kept);
        void *const data[] = {vertex, triangle, color};
        for (int k = 0; k < PIFU_KEPT; k++) kept.array[k].dim[0] = 1, kept.array[k].data = data[k];
        if (cases[i].what == 0) triangle[1] = -1;
        if (cases[i].what == 1) ((float *)data[cases[i].array])[2] = NAN;
        if (cases[i].what == 2) kept.array[PIFU_COLORS].dim[0] = 2;
        const field_source from = {.config = &config, .kept = &kept};
        assert_fails(c, pifu_field.create(c, &from, NULL, &field), SHERF_BAD_FILE, cases[i].says);
        assert_null(field);
    }
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void every_allocation_fails(void **state) {
    rival_no_memory("pifu:own-small,stacks=1,width=16,color_width=4,hidden0=8,hidden1=0,hidden2=0,side_px=64,"
                    "resolution=16");
}

/* An evaluation reports the observation's surface beside the pictures' scores. */
static void its_surface_is_scored(void **state) {
    context *c = test_context();
    sherf_model *m;
    sherf_scores s;
    char data[700], path[700], body[700];
    trained(c, &m);
    snprintf(path, sizeof path, "%s", rival_file("scored.safetensors"));
    assert_ok(c, sherf_model_save(c, m, path));
    sherf_model_free(m);
    snprintf(data, sizeof data, "thuman:%s", rival_file(""));
    snprintf(body, sizeof body, "%s", rival_file("tubeman.safetensors"));
    const sherf_eval_options o = {.data = data,
                                  .people = "0-0",
                                  .body = body,
                                  .model = path,
                                  .observations = "0:0",
                                  .poses = "0",
                                  .views = "0,1"};
    assert_ok(c, sherf_eval(c, &o, &s));
    assert_true(s.novel_view.count == 1 && s.surfaces.count == 1 && s.surfaces.missed == 0);
    print_message("Chamfer %.1f cm, normals %.0f degrees\n", s.surfaces.chamfer_cm, s.surfaces.normal_deg);
    assert_true(s.surfaces.chamfer_cm > 0.5 && s.surfaces.chamfer_cm < 40);
    assert_non_null(strstr(s.table, "surfaces of 1 observations"));
    sherf_free(s.table);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void it_is_scored_in_the_observed_pose(void **state) {
    rival_is_scored(tiny, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(counts_are_those_of_the_paper),
                                       cmocka_unit_test(settings_that_do_not_go_together),
                                       cmocka_unit_test(the_square_is_about_the_person),
                                       cmocka_unit_test(it_learns_what_is_inside),
                                       cmocka_unit_test(coarse_to_fine),
                                       cmocka_unit_test(its_surface_is_scored),
                                       cmocka_unit_test(it_goes_on_with_the_same_bits),
                                       cmocka_unit_test(one_line),
                                       cmocka_unit_test(trainings_that_are_refused),
                                       cmocka_unit_test(damaged_avatars),
                                       cmocka_unit_test(every_allocation_fails),
                                       cmocka_unit_test(it_is_scored_in_the_observed_pose)};
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
