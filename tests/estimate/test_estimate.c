/* Tests of estimates from a photo to an observation: the shipped photo of a made person with the shipped
 * networks. */
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

#include "base/path.h"
#include "estimate/estimate.h"
#include "io/image.h"
#include "support.h"

static const char photo_path[] = "../assets/demo/photo.jpg";

typedef struct {
    context *c;
    sherf_estimator *networks;
    sherf_body *body;
    sherf_estimate *e; /* pixels of the whole photo */
} scene;
static scene s;

static int open_scene(void **state) {
    s.c = test_context();
    return sherf_estimator_load(s.c, "../assets/models/blazepose.safetensors", &s.networks) ||
           sherf_body_load(s.c, "../assets/body.safetensors", &s.body) ||
           sherf_estimate_photo(s.c, s.networks, s.body, photo_path, NULL, &s.e);
}

static int close_scene(void **state) {
    sherf_estimate_free(s.e);
    sherf_body_free(s.body);
    sherf_estimator_free(s.networks);
    sherf_context_free(s.c);
    return mem_live() != 0;
}

/* The person stands, seen from the front, from head to feet. */
static void the_person_stands(void **state) {
    const sherf_estimate_facts *f = sherf_estimate_found(s.e);
    assert_int_equal(f->people, 1);
    assert_int_equal(f->person, 1);
    assert_int_equal(f->warnings, 0);
    assert_true(f->person_px > 800 && f->person_px < 1000);
    assert_true(f->landmarks_off < 0.015);
    assert_true(f->mask_covered > 0.8 && f->body_inside > 0.9);
    assert_true(fabs(f->lean_deg) < 8);
    assert_true(f->box_px[1] < 90 && f->box_px[3] > 940);
    /* upright, on the floor, and in front of the camera */
    float joints[72];
    assert_ok(s.c, sherf_body_pose(s.c, s.body, sherf_estimate_pose(s.e), NULL, joints));
    const float *head = joints + 3 * 15, *pelvis = joints;
    assert_true(head[1] > pelvis[1] + 0.4f && pelvis[1] > 0.7f && pelvis[1] < 1.2f);
    for (int side = 0; side < 2; side++) { /* knees of straight legs */
        const float *knee = sherf_estimate_pose(s.e)->poses_rad + 3 * (4 + side);
        const double bend = sqrt(knee[0] * knee[0] + knee[1] * knee[1] + knee[2] * knee[2]);
        if (!(bend < 20 * M_PI / 180)) fail_msg("knee %d is bent by %.0f degrees", side, bend * 180 / M_PI);
    }
    const sherf_camera *k = sherf_estimate_camera(s.e);
    double x[3];
    for (int i = 0; i < 3; i++) {
        x[i] = k->T_m[i];
        for (int j = 0; j < 3; j++) x[i] += (double)k->R[3 * i + j] * head[j];
    }
    const double row = k->K[4] * x[1] / x[2] + k->K[5];
    assert_true(x[2] > 1 && row > f->box_px[1] && row < f->box_px[1] + 0.2 * f->person_px);
}

static void same(const sherf_estimate *a, const sherf_estimate *b) {
    const size_t n = (size_t)a->mask.width * (size_t)a->mask.height;
    assert_memory_equal(sherf_estimate_pose(a), sherf_estimate_pose(b), sizeof(sherf_pose));
    assert_memory_equal(sherf_estimate_camera(a), sherf_estimate_camera(b), sizeof(sherf_camera));
    assert_memory_equal(a->mask.data, b->mask.data, n * sizeof(float));
    assert_memory_equal(a->color.data, b->color.data, 3 * n * sizeof(float));
}

static void the_same_bits(void **state) {
    sherf_estimate *again;
    s.c->threads = 1;
    assert_ok(s.c, sherf_estimate_picture(s.c, s.networks, s.body, &s.e->photo, NULL, NULL, &again));
    s.c->threads = 2;
    same(s.e, again);
    sherf_estimate_free(again);
}

/* The same person and a squeezed, thinner one. The shared shape is in between, and both still fit their
 * photos. */
static void photos_share_a_shape(void **state) {
    sherf_estimate *e[2];
    sherf_image thin = {s.e->photo.width, s.e->photo.height, 3, NULL};
    const size_t n = (size_t)thin.width * (size_t)thin.height * 3;
    float apart = 0;
    thin.data = mem_alloc(s.c, n, sizeof(float));
    memcpy(thin.data, s.e->photo.data, n * sizeof(float));
    assert_ok(s.c, image_resize_area(s.c, &thin, thin.width * 17 / 20, thin.height));
    assert_ok(s.c, sherf_estimate_picture(s.c, s.networks, s.body, &s.e->photo, NULL, NULL, &e[0]));
    assert_ok(s.c, sherf_estimate_picture(s.c, s.networks, s.body, &thin, NULL, NULL, &e[1]));
    for (int b = 0; b < BODY_SHAPES; b++)
        apart = fmaxf(apart, fabsf(e[0]->fit.pose.shapes[b] - e[1]->fit.pose.shapes[b]));
    assert_true(apart > 0.1f);
    const float first = e[0]->fit.pose.shapes[0], second = e[1]->fit.pose.shapes[0];
    assert_ok(s.c, sherf_estimate_share_shape(s.c, s.body, 2, e));
    for (int b = 0; b < BODY_SHAPES; b++)
        assert_true(fabsf(e[0]->fit.pose.shapes[b] - e[1]->fit.pose.shapes[b]) < 0.01f);
    assert_true((e[0]->fit.pose.shapes[0] - first) * (e[0]->fit.pose.shapes[0] - second) <= 1e-3f);
    for (int i = 0; i < 2; i++) {
        const sherf_estimate_facts *f = sherf_estimate_found(e[i]);
        print_message("landmarks %.1f %% off, %.0f %% of the mask covered\n", 100 * f->landmarks_off,
                      100 * f->mask_covered);
        assert_true(f->landmarks_off < 0.02 && f->mask_covered > 0.75 && f->body_inside > 0.85);
        sherf_estimate_free(e[i]);
    }
    mem_free(thin.data);
}

static void a_folder_is_an_observation(void **state) {
    const char *folder = test_path("estimate");
    sherf_observation *direct, *read;
    assert_ok(s.c, sherf_estimate_save(s.c, s.e, s.body, folder));
    assert_ok(s.c, sherf_estimate_observation(s.c, s.e, &direct));
    assert_ok(s.c, sherf_observation_load(s.c, folder, &read));
    const size_t n = (size_t)direct->image.width * (size_t)direct->image.height;
    size_t other = 0;
    for (size_t i = 0; i < n; i++) other += direct->mask[i] != read->mask[i];
    assert_true(other < n / 1000);
    for (size_t i = 0; i < 3 * n; i++)
        if (direct->mask[i / 3] && read->mask[i / 3])
            assert_true(fabsf(direct->image.data[i] - read->image.data[i]) < 0.003f);
    for (int i = 0; i < 72; i++)
        assert_true(fabsf(direct->pose.poses_rad[i] - read->pose.poses_rad[i]) < 1e-6f);
    for (int i = 0; i < 3; i++) assert_true(fabsf(direct->pose.Th_m[i] - read->pose.Th_m[i]) < 1e-6f);
    for (int i = 0; i < 9; i++) {
        assert_true(fabsf(direct->camera.K[i] - read->camera.K[i]) < 1e-3f);
        assert_true(fabsf(direct->camera.R[i] - read->camera.R[i]) < 1e-6f);
    }
    sherf_findings found;
    assert_ok(s.c, sherf_check(s.c, folder, s.body, NULL, &found));
    if (found.errors) fail_msg("%s", found.text);
    sherf_free(found.text);
    char overlay[1024];
    int size[2], channels;
    snprintf(overlay, sizeof overlay, "%s/overlay.png", folder);
    assert_ok(s.c, image_size(s.c, overlay, &size[0], &size[1], &channels));
    assert_int_equal(size[0], s.e->photo.width);
    sherf_observation_free(direct);
    sherf_observation_free(read);
}

/* Two people side by side: the photo at full and at half size. */
static void two_people(sherf_image *out, sherf_image *mask) {
    const sherf_image *p = &s.e->photo;
    const int width = p->width + p->width / 2;
    const size_t n = (size_t)width * (size_t)p->height;
    *out = (sherf_image){width, p->height, 3, mem_alloc(s.c, 3 * n, sizeof(float))};
    *mask = (sherf_image){width, p->height, 1, mem_zero(s.c, n, sizeof(float))};
    assert_true(out->data && mask->data);
    for (int y = 0; y < p->height; y++)
        for (int x = 0; x < width; x++) {
            const bool small = x >= p->width;
            const int u = small ? 2 * (x - p->width) : x, v = small ? (2 * y) % p->height : y;
            const size_t from = (size_t)v * (size_t)p->width + (size_t)u,
                         at = (size_t)y * (size_t)width + (size_t)x;
            memcpy(out->data + 3 * at, p->data + 3 * from, 3 * sizeof(float));
            /* the mask of the small person below */
            if (small && 2 * y >= p->height) mask->data[at] = s.e->mask.data[from];
        }
}

static void the_one_that_is_asked_for(void **state) {
    sherf_image photo, mask;
    sherf_estimate *e;
    two_people(&photo, &mask);
    assert_ok(s.c, sherf_estimate_picture(s.c, s.networks, s.body, &photo, NULL, NULL, &e));
    const sherf_estimate_facts *f = sherf_estimate_found(e);
    assert_true(f->people >= 2 && f->person == 1);
    assert_true(f->box_px[2] < (float)s.e->photo.width && f->person_px > 800);
    const int people = f->people;
    sherf_estimate_free(e);
    const sherf_estimate_options second = {.person = 2}, none = {.person = people + 1};
    assert_ok(s.c, sherf_estimate_picture(s.c, s.networks, s.body, &photo, NULL, &second, &e));
    assert_true(sherf_estimate_found(e)->box_px[0] > (float)s.e->photo.width - 20);
    assert_true(sherf_estimate_found(e)->person_px < 600);
    sherf_estimate_free(e);
    if (people < PHOTO_PEOPLE_MAX) {
        assert_int_equal(sherf_estimate_picture(s.c, s.networks, s.body, &photo, NULL, &none, &e),
                         SHERF_BAD_ARGUMENT);
        assert_non_null(strstr(sherf_message(s.c), "were found"));
    }
    /* a mask selects the person */
    assert_ok(s.c, sherf_estimate_picture(s.c, s.networks, s.body, &photo, &mask, NULL, &e));
    assert_true(sherf_estimate_found(e)->box_px[0] > (float)s.e->photo.width - 20);
    assert_true(sherf_estimate_found(e)->box_px[1] > (float)s.e->photo.height / 2);
    sherf_estimate_free(e);
    mem_free(photo.data);
    mem_free(mask.data);
}

/* A picture with a transparent background provides its own mask. */
static void alpha_is_a_mask(void **state) {
    const sherf_image *p = &s.e->photo;
    const size_t n = (size_t)p->width * (size_t)p->height;
    const char *path = test_path("cut.png");
    uint8_t *rgba = mem_alloc(s.c, n, 4);
    sherf_estimate *e;
    for (size_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) rgba[4 * i + (size_t)k] = float_to_u8(p->data[3 * i + (size_t)k]);
        rgba[4 * i + 3] = s.e->mask.data[i] >= 0.5f ? 255 : 0;
    }
    assert_ok(s.c, png_write(s.c, path, p->width, p->height, 4, rgba));
    assert_ok(s.c, sherf_estimate_photo(s.c, s.networks, s.body, path, NULL, &e));
    for (size_t i = 0; i < n; i++) assert_true(e->mask.data[i] == (rgba[4 * i + 3] ? 1.0f : 0.0f));
    sherf_estimate_free(e);
    mem_free(rgba);
}

static void known_focal_length(void **state) {
    sherf_estimate *e;
    const sherf_estimate_options o = {.focal_px = 900};
    assert_ok(s.c, sherf_estimate_photo(s.c, s.networks, s.body, photo_path, &o, &e));
    assert_true(fabs(sherf_estimate_found(e)->focal_px - 900) < 9); /* a prior of 1 % */
    sherf_estimate_free(e);
}

static void refused(const char *path, const sherf_estimate_options *o, sherf_status status,
                    const char *part) {
    sherf_estimate *e = NULL;
    assert_int_equal(sherf_estimate_photo(s.c, s.networks, s.body, path, o, &e), status);
    assert_null(e);
    if (!strstr(sherf_message(s.c), part)) fail_msg("'%s' does not say '%s'", sherf_message(s.c), part);
    assert_null(strchr(sherf_message(s.c), '\n'));
}

/* Columns and rows starting at `at`. */
static sherf_image piece_of(const sherf_image *from, int left, int top, int width, int height) {
    sherf_image out = {width, height, 3, mem_alloc(s.c, (size_t)width * (size_t)height, 3 * sizeof(float))};
    for (int y = 0; y < height; y++)
        memcpy(out.data + (size_t)y * (size_t)width * 3,
               from->data + ((size_t)(top + y) * (size_t)from->width + (size_t)left) * 3,
               (size_t)width * 3 * sizeof(float));
    return out;
}

/* A head alone does not show the body; from the waist up is enough for a guess. */
static void a_head_alone_is_refused(void **state) {
    const sherf_estimate_facts *f = sherf_estimate_found(s.e);
    const int middle = (int)(f->box_px[0] + f->box_px[2]) / 2, top = (int)f->box_px[1] - 20;
    for (int waist = 0; waist < 2; waist++) {
        const int half = waist ? 200 : 70, height = waist ? 500 : 150;
        sherf_estimate *e = NULL;
        sherf_image piece = piece_of(&s.e->photo, middle - half, top, 2 * half, height);
        const sherf_status status = sherf_estimate_picture(s.c, s.networks, s.body, &piece, NULL, NULL, &e);
        if (waist)
            assert_ok(s.c, status);
        else
            assert_true(status == SHERF_MISMATCH && !e);
        if (e) assert_true(sherf_estimate_found(e)->warnings & SHERF_ESTIMATE_CUT_FEET);
        if (e && fabs(log2(sherf_estimate_found(e)->person_px / f->person_px)) > 1)
            fail_msg("%.0f pixels high, not %.0f", sherf_estimate_found(e)->person_px, f->person_px);
        if (!e) assert_non_null(strstr(sherf_message(s.c), "only a head"));
        sherf_image_free(&piece);
        sherf_estimate_free(e);
    }
}

/* A full disk leaves no new folder and does not change an existing one. */
static void a_folder_is_whole_or_not_there(void **state) {
    struct rlimit limit, little;
    const char *folder = test_path("half");
    char text[2][1024];
    unsigned char *before, *after;
    size_t bytes[2];
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &limit), 0);
    signal(SIGXFSZ, SIG_IGN);
    for (int there = 0; there < 2; there++) {
        little = limit;
        little.rlim_cur = there ? 1200 : 100000; /* not even the text fits; only a picture does not fit */
        snprintf(text[0], sizeof text[0], "%s/observation.json", folder);
        snprintf(text[1], sizeof text[1], "%s/image.png", folder);
        if (there) assert_ok(s.c, sherf_estimate_save(s.c, s.e, s.body, folder));
        if (there) assert_ok(s.c, file_read(s.c, text[1], (size_t)1 << 28, &before, &bytes[0]));
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &little), 0);
        const sherf_status status = sherf_estimate_save(s.c, s.e, s.body, folder);
        assert_int_equal(setrlimit(RLIMIT_FSIZE, &limit), 0);
        assert_int_equal(status, SHERF_WRITE_FAILED);
        assert_int_equal(path_is_folder(folder), there);
        if (!there) continue;
        assert_ok(s.c, file_read(s.c, text[1], (size_t)1 << 28, &after, &bytes[1]));
        assert_true(bytes[0] == bytes[1] && !memcmp(before, after, bytes[0]));
        assert_true(path_is_file(text[0]));
        mem_free(before);
        mem_free(after);
    }
    signal(SIGXFSZ, SIG_DFL);
}

static void what_is_refused(void **state) {
    sherf_estimator *none;
    uint8_t *noise = mem_alloc(s.c, 160 * 120, 3);
    for (int i = 0; i < 160 * 120 * 3; i++) noise[i] = (uint8_t)random_below(3, (uint64_t)i, 256);
    const char *path = test_path("noise.png"), *small = test_path("one.png"), *text = test_path("text.jpg");
    assert_ok(s.c, png_write(s.c, path, 160, 120, 3, noise));
    assert_ok(s.c, png_write(s.c, small, 1, 1, 3, noise));
    mem_free(noise);
    FILE *f = fopen(text, "w");
    fputs("<!DOCTYPE html><html></html>", f);
    fclose(f);
    refused(path, NULL, SHERF_MISMATCH, "noise.png: nobody was found");
    refused(small, NULL, SHERF_MISMATCH, "nobody");
    refused(text, NULL, SHERF_BAD_FILE, "text.jpg");
    refused("/no/such.jpg", NULL, SHERF_NO_FILE, "/no/such.jpg");
    refused(photo_path, &(sherf_estimate_options){.mask = path}, SHERF_MISMATCH, "noise.png");
    refused(photo_path, &(sherf_estimate_options){.person = 9}, SHERF_BAD_ARGUMENT, "1 to 8");
    refused(photo_path, &(sherf_estimate_options){.person = 2}, SHERF_BAD_ARGUMENT, "1 was found");
    refused(photo_path, &(sherf_estimate_options){.focal_px = NAN}, SHERF_BAD_ARGUMENT, "focal length");
    assert_int_equal(sherf_estimator_load(s.c, "../assets/body.safetensors", &none), SHERF_MISMATCH);
    assert_null(none);
    sherf_cancel(s.c);
    sherf_estimate *e;
    assert_int_equal(sherf_estimate_photo(s.c, s.networks, s.body, photo_path, NULL, &e), SHERF_CANCELLED);
    sherf_cancel_reset(s.c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_person_stands),
                                       cmocka_unit_test(the_same_bits),
                                       cmocka_unit_test(photos_share_a_shape),
                                       cmocka_unit_test(a_folder_is_an_observation),
                                       cmocka_unit_test(the_one_that_is_asked_for),
                                       cmocka_unit_test(alpha_is_a_mask),
                                       cmocka_unit_test(known_focal_length),
                                       cmocka_unit_test(a_head_alone_is_refused),
                                       cmocka_unit_test(a_folder_is_whole_or_not_there),
                                       cmocka_unit_test(what_is_refused)};
    return cmocka_run_group_tests(tests, open_scene, close_scene);
}
