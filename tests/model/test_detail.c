/* The observation's detail in frames, with the shipped model and the demo's person. */
#include <math.h>
#include <string.h>

#include "model/model.h"
#include "support.h"

static const char model_path[] = "../assets/models/people.safetensors",
                  body_path[] = "../assets/body.safetensors";
enum { SIDE = 256 };

typedef struct {
    context *c;
    sherf_body *body;
    sherf_observation *observation;
    sherf_avatar *avatar;
    sherf_camera camera;
} scene;

static void open_scene(scene *s) {
    const sherf_options options = {.threads = 2};
    sherf_model *m;
    sherf_observation *read;
    assert_int_equal(sherf_context_create(&options, &s->c), SHERF_OK);
    assert_ok(s->c, sherf_body_load(s->c, body_path, &s->body));
    assert_ok(s->c, sherf_model_load(s->c, model_path, &m));
    assert_ok(s->c, sherf_observation_load(s->c, "thuman:../assets/demo#person_900006/0/0", &read));
    assert_ok(s->c, sherf_observation_fit(s->c, m, s->body, read, &s->observation));
    assert_ok(s->c, sherf_avatar_create(s->c, m, s->body, s->observation, &s->avatar));
    s->camera = *sherf_observation_camera(s->observation);
    assert_int_equal(s->camera.width_px, SIDE);
    assert_int_equal(s->camera.height_px, SIDE);
    sherf_observation_free(read);
    sherf_model_free(m);
}

static void close_scene(scene *s) {
    sherf_avatar_free(s->avatar);
    sherf_observation_free(s->observation);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
}

static void render(scene *s, const sherf_camera *camera, int detail, sherf_frame *out) {
    const sherf_render_options o = {.samples = SHERF_SAMPLES_MODEL, .detail = detail};
    assert_ok(s->c, sherf_render(s->c, s->avatar, s->body, sherf_avatar_pose(s->avatar), camera, &o, out));
}

static double difference(const float *a, const float *b) {
    double sum = 0;
    for (size_t i = 0; i < 3 * SIDE * SIDE; i++) sum += pow((double)a[i] - b[i], 2);
    return sum;
}

static void the_observed_view_is_the_observation(void **state) {
    scene s;
    sherf_frame before = {0}, off = {0}, on = {0};
    open_scene(&s);
    render(&s, &s.camera, 0, &before);
    assert_null(s.avatar->detail.kept.texel); /* not made for those who do not want it */
    render(&s, &s.camera, SHERF_DETAIL_ON, &on);
    render(&s, &s.camera, SHERF_DETAIL_OFF, &off);
    assert_non_null(s.avatar->detail.kept.texel);
    assert_memory_equal(off.color.data, before.color.data, 3 * SIDE * SIDE * sizeof(float));
    assert_memory_equal(on.opacity.data, off.opacity.data, SIDE * SIDE * sizeof(float));
    assert_memory_equal(on.depth.data, off.depth.data, SIDE * SIDE * sizeof(float));
    assert_int_equal(on.points, off.points);
    const float *truth = sherf_observation_image(s.observation)->data;
    const double soft = difference(off.color.data, truth), sharp = difference(on.color.data, truth);
    if (!(sharp < 0.6 * soft)) fail_msg("squared difference %g with detail, %g without", sharp, soft);
    for (size_t i = 0; i < 3 * SIDE * SIDE; i++) {
        assert_true(on.color.data[i] >= 0 && on.color.data[i] <= 1);
        if (off.opacity.data[i / 3] < 0.5f) assert_true(on.color.data[i] == off.color.data[i]);
    }
    sherf_frame_free(&before);
    sherf_frame_free(&off);
    sherf_frame_free(&on);
    close_scene(&s);
}

/* From the other side: x and z of the camera's axes turned about its point of view on the person. */
static void the_other_side_stays(void **state) {
    scene s;
    sherf_frame off = {0}, on = {0}, near = {0}, near_on = {0};
    open_scene(&s);
    const sherf_pose *pose = sherf_avatar_pose(s.avatar);
    float joints[72], place[3];
    assert_ok(s.c, sherf_body_pose(s.c, s.body, pose, NULL, joints));
    for (int turn = 0; turn < 2; turn++) {
        const double angle = turn ? 0.3 : M_PI;
        const float turned[9] = {(float)cos(angle),  0, (float)sin(angle), 0, 1, 0,
                                 (float)-sin(angle), 0, (float)cos(angle)};
        sherf_camera k = s.camera;
        for (int i = 0; i < 3; i++) {
            place[i] = s.camera.T_m[i];
            for (int j = 0; j < 3; j++) place[i] += s.camera.R[3 * i + j] * joints[j];
        }
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                k.R[3 * i + j] = 0;
                for (int l = 0; l < 3; l++) k.R[3 * i + j] += turned[3 * i + l] * s.camera.R[3 * l + j];
            }
        for (int i = 0; i < 3; i++) { /* the pelvis stays where it is in the picture */
            k.T_m[i] = place[i];
            for (int j = 0; j < 3; j++) k.T_m[i] -= k.R[3 * i + j] * joints[j];
        }
        render(&s, &k, SHERF_DETAIL_OFF, turn ? &near : &off);
        render(&s, &k, SHERF_DETAIL_ON, turn ? &near_on : &on);
    }
    const double hidden = difference(on.color.data, off.color.data);
    const double seen = difference(near_on.color.data, near.color.data);
    if (!(seen > 5 && hidden < 0.05 * seen))
        fail_msg("%g on the hidden side, %g on the seen one", hidden, seen);
    sherf_frame_free(&off);
    sherf_frame_free(&on);
    sherf_frame_free(&near);
    sherf_frame_free(&near_on);
    close_scene(&s);
}

/* The viewer renders pictures in bands. */
static void bands_make_the_picture(void **state) {
    scene s;
    sherf_frame whole = {0}, band = {0};
    open_scene(&s);
    sherf_camera k = s.camera;
    render(&s, &k, SHERF_DETAIL_ON, &whole);
    const int top = 64;
    k.height_px = 64;
    k.K[5] -= (float)top;
    render(&s, &k, SHERF_DETAIL_ON, &band);
    double most = 0;
    for (size_t i = 0; i < 3 * 64 * SIDE; i++)
        most = fmax(most, fabs((double)band.color.data[i] - whole.color.data[3 * (size_t)top * SIDE + i]));
    if (!(most < 0.03)) fail_msg("differs by %g", most);
    sherf_frame_free(&whole);
    sherf_frame_free(&band);
    close_scene(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_observed_view_is_the_observation),
                                       cmocka_unit_test(the_other_side_stays),
                                       cmocka_unit_test(bands_make_the_picture)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
