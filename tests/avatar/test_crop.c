/* Tests of observations scaled to a model's size: the same scene under the same camera, only scaled. */
#include "support.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "model/model.h"
#include "scene/scene.h"

enum { WIDTH = 900, HEIGHT = 700 };
static sherf_body *body;

static int make_body(void **state) {
    context *c = test_context();
    const sherf_synth_options options = {.people = 1, .poses = 1, .views = 1, .size_px = 32};
    assert_ok(c, sherf_synth_tube(c, test_path("people"), &options));
    assert_ok(c, sherf_body_load(c, test_path("people/tubeman.safetensors"), &body));
    sherf_context_free(c);
    return 0;
}

static int free_body(void **state) {
    sherf_body_free(body);
    return 0;
}

/* Red grows to the right, green downward; blue marks the person's mask, a wide ellipse. */
static sherf_observation *picture(context *c, float focal_px, float x_m) {
    sherf_image image = {WIDTH, HEIGHT, 3, malloc(sizeof(float) * WIDTH * HEIGHT * 3)};
    sherf_image mask = {WIDTH, HEIGHT, 1, malloc(sizeof(float) * WIDTH * HEIGHT)};
    sherf_camera camera = {.width_px = WIDTH,
                           .height_px = HEIGHT,
                           .K = {focal_px, 0, 480, 0, focal_px, 330, 0, 0, 1},
                           .R = {1, 0, 0, 0, -1, 0, 0, 0, -1},
                           .T_m = {x_m, -0.2f, 4}};
    sherf_pose pose;
    sherf_observation *o;
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) {
            float *p = image.data + 3 * (y * WIDTH + x);
            p[0] = (float)x / WIDTH, p[1] = (float)y / HEIGHT, p[2] = 1;
            mask.data[y * WIDTH + x] = x > 20 && y > 20;
        }
    sherf_pose_identity(&pose);
    assert_ok(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &o));
    free(image.data);
    free(mask.data);
    return o;
}

static void project(const sherf_observation *o, const float world[3], float uv[2]) {
    float depth;
    camera_project(sherf_observation_camera(o), 1, world, uv, &depth);
}

/* Places near the body have the same colour in both pictures. */
static void assert_same_scene(const sherf_observation *a, const sherf_observation *b, double tolerance) {
    const float joints[][3] = {{0, 0.2f, 0}, {0.3f, 0.1f, 0}, {-0.2f, -0.5f, 0.1f}, {0.1f, 0.4f, -0.1f}};
    for (size_t j = 0; j < COUNT_OF(joints); j++) {
        float u[2], v[2];
        project(a, joints[j], u);
        project(b, joints[j], v);
        const sherf_image *image = sherf_observation_image(b);
        const int x = (int)lrintf(v[0]), y = (int)lrintf(v[1]);
        assert_true(x >= 0 && y >= 0 && x < image->width && y < image->height);
        const float *p = image->data + 3 * (y * image->width + x);
        assert_true(fabs((double)p[0] * WIDTH - (double)u[0]) < tolerance);
        assert_true(fabs((double)p[1] * HEIGHT - (double)u[1]) < tolerance);
        assert_float_equal(p[2], 1, 1e-4);
    }
}

static sherf_model *knowing(context *c, int image_size, int px_per_m) {
    sherf_model *m;
    assert_ok(c, sherf_model_create(c, "small,encoder_width=8,plane_resolution=8", 1, &m));
    m->config.image_size = image_size;
    m->config.px_per_m = px_per_m;
    return m;
}

/* 300 px a metre in the picture; the model knows people at 100, in pictures of 256 that show all of the body.
 */
static void large_people_shrink(void **state) {
    context *c = test_context();
    sherf_model *m = knowing(c, 256, 100);
    sherf_observation *o = picture(c, 1200, 0.1f), *fit;
    double scale;
    assert_ok(c, sherf_observation_crop(c, m, body, o, &fit));
    const sherf_camera *k = sherf_observation_camera(fit);
    assert_int_equal(k->width_px, 256);
    assert_int_equal(k->height_px, 256);
    assert_int_equal(sherf_observation_image(fit)->width, 256);
    assert_ok(c, body_px_per_m(c, body, sherf_observation_pose(fit), k, &scale));
    assert_float_equal(scale, 115, 1);
    assert_same_scene(o, fit, 4); /* one and a half pixels of the smaller picture */
    sherf_observation_free(fit);
    sherf_observation_free(o);
    sherf_model_free(m);
    sherf_context_free(c);
}

/* A person at the edge, 37 px a metre: grown, black beyond the edge. */
static void small_people_grow(void **state) {
    context *c = test_context();
    sherf_model *m = knowing(c, 256, 100);
    sherf_observation *o = picture(c, 150, 0), *fit;
    assert_ok(c, sherf_observation_crop(c, m, body, o, &fit));
    assert_int_equal(sherf_observation_image(fit)->width, 256);
    assert_same_scene(o, fit, 1);
    sherf_observation_free(fit);
    sherf_observation_free(o);
    o = picture(c, 150, 11.5f);
    assert_ok(c, sherf_observation_crop(c, m, body, o, &fit));
    const sherf_image *image = sherf_observation_image(fit);
    float beyond = 0;
    for (int y = 0; y < image->height; y++) beyond += image->data[3 * ((y + 1) * image->width - 1)];
    assert_float_equal(beyond, 0, 0);
    sherf_observation_free(fit);
    sherf_observation_free(o);
    sherf_model_free(m);
    sherf_context_free(c);
}

/* At the model's own scale, and for models that do not state theirs, the picture stays the same to the bit.
 */
static void fitting_pictures_stay(void **state) {
    context *c = test_context();
    sherf_model *m[] = {knowing(c, 900, 110), knowing(c, 256, 0), knowing(c, 0, 100)};
    sherf_observation *o = picture(c, 420, 0.1f), *fit;
    for (size_t i = 0; i < COUNT_OF(m); i++) {
        assert_ok(c, sherf_observation_crop(c, m[i], body, o, &fit));
        assert_memory_equal(sherf_observation_camera(fit), sherf_observation_camera(o), sizeof(sherf_camera));
        assert_memory_equal(sherf_observation_image(fit)->data, sherf_observation_image(o)->data,
                            sizeof(float) * WIDTH * HEIGHT * 3);
        sherf_observation_free(fit);
        sherf_model_free(m[i]);
    }
    sherf_observation_free(o);
    sherf_context_free(c);
}

/* A crop round a body outside the mask would be a black picture with the body in its middle. */
static void bodies_elsewhere_are_refused(void **state) {
    context *c = test_context();
    sherf_model *m = knowing(c, 256, 150);
    sherf_observation *o = picture(c, 420, 40), *fit;
    assert_int_equal(sherf_observation_crop(c, m, body, o, &fit), SHERF_MISMATCH);
    assert_non_null(strstr(c->message, "outside the picture"));
    assert_null(fit);
    sherf_observation_free(o);
    sherf_model_free(m);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(large_people_shrink),
        cmocka_unit_test(small_people_grow),
        cmocka_unit_test(fitting_pictures_stay),
        cmocka_unit_test(bodies_elsewhere_are_refused),
    };
    return cmocka_run_group_tests(tests, make_body, free_body);
}
