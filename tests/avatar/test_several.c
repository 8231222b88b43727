/* Tests of avatars of several pictures, with the shipped model and the demo's person seen from behind. */
#include <math.h>
#include <string.h>

#include "avatar/detail.h"
#include "demo_scene.h"

typedef struct {
    float red, green; /* means over opaque pixels */
    int pixels;
} tint;

static tint render(scene *s, const sherf_avatar *a, const sherf_camera *camera, sherf_frame *frame) {
    tint sum = {0};
    const sherf_render_options o = {.samples = SHERF_SAMPLES_MODEL, .detail = SHERF_DETAIL_ON};
    assert_ok(s->c, sherf_render(s->c, a, s->body, sherf_avatar_pose(a), camera, &o, frame));
    for (size_t i = 0; i < (size_t)frame->color.width * (size_t)frame->color.height; i++) {
        if (frame->opacity.data[i] < 0.9f) continue;
        sum.pixels++;
        sum.red += frame->color.data[3 * i];
        sum.green += frame->color.data[3 * i + 1];
    }
    sum.red /= (float)sum.pixels;
    sum.green /= (float)sum.pixels;
    return sum;
}

/* The observed camera on the other side of the person. */
static sherf_camera opposite(scene *s) {
    float joints[72];
    sherf_camera k = s->camera;
    assert_ok(s->c, sherf_body_pose(s->c, s->body, sherf_avatar_pose(s->avatar), NULL, joints));
    for (int i = 0; i < 3; i++) { /* half a turn about the vertical through the pelvis */
        k.R[3 * i] = -k.R[3 * i];
        k.R[3 * i + 2] = -k.R[3 * i + 2];
        k.T_m[i] =
            s->camera.T_m[i] + 2 * (s->camera.R[3 * i] * joints[0] + s->camera.R[3 * i + 2] * joints[2]);
    }
    return k;
}

/* A picture from there, as the avatar renders it, but in red. */
static sherf_observation *paint_other_side(scene *s, const sherf_camera *camera) {
    sherf_frame frame = {0};
    sherf_observation *out;
    render(s, s->avatar, camera, &frame);
    const size_t n = (size_t)frame.color.width * (size_t)frame.color.height;
    for (size_t i = 0; i < n; i++) {
        frame.opacity.data[i] = frame.opacity.data[i] > 0.5f;
        for (int k = 0; k < 3; k++)
            frame.color.data[3 * i + (size_t)k] = (k ? 0.1f : 0.8f) * frame.opacity.data[i];
    }
    assert_ok(s->c, sherf_observation_create(s->c, &frame.color, &frame.opacity, camera,
                                             sherf_avatar_pose(s->avatar), &out));
    sherf_frame_free(&frame);
    return out;
}

/* Paints the person white after the network has seen the picture: frames show it as detail. */
static void whiten(sherf_avatar *a, int picture) {
    const sherf_image *image = &a->picture[picture].image;
    assert_null(a->fine[picture].data);
    for (size_t i = 0; i < (size_t)image->width * (size_t)image->height; i++) {
        float *rgb = image->data + 3 * i;
        if (rgb[0] + rgb[1] + rgb[2] > 0) rgb[0] = rgb[1] = rgb[2] = 1;
    }
    detail_free(&a->detail->made);
}

static void each_side_is_its_pictures(void **state) {
    scene s;
    sherf_model *m;
    sherf_avatar *both, *loaded;
    sherf_frame frame = {0}, again = {0};
    open_scene(&s, SHERF_PRECISION_AUTO);
    const sherf_camera other = opposite(&s);
    sherf_observation *red = paint_other_side(&s, &other);
    const sherf_observation *given[] = {s.observation, red};
    assert_ok(s.c, sherf_model_load(s.c, "../assets/models/people.safetensors", &m));
    assert_ok(s.c, sherf_avatar_create_several(s.c, m, s.body, 2, given, &both));
    const tint own = render(&s, s.avatar, &s.camera, &frame), now = render(&s, both, &s.camera, &frame),
               front = render(&s, both, &other, &frame);
    print_message("red and green: %.2f %.2f of one picture, %.2f %.2f of two; other side %.2f %.2f\n",
                  (double)own.red, (double)own.green, (double)now.red, (double)now.green, (double)front.red,
                  (double)front.green);
    assert_true(fabsf(own.red - now.red) < 0.05f && fabsf(own.green - now.green) < 0.05f);
    assert_true(front.red > 0.5f && front.green < 0.25f);
    assert_ok(s.c, sherf_avatar_save(s.c, both, test_path("both")));
    assert_ok(s.c, sherf_avatar_load(s.c, test_path("both"), s.body, &loaded));
    render(&s, loaded, &other, &again);
    whiten(loaded, 1);
    sherf_frame painted = {0};
    const tint white = render(&s, loaded, &other, &painted), same = render(&s, loaded, &s.camera, &painted);
    assert_true(white.green > front.green + 0.4f && fabsf(same.green - now.green) < 0.05f);
    sherf_frame_free(&painted);
    assert_memory_equal(frame.color.data, again.color.data,
                        3 * (size_t)frame.color.width * (size_t)frame.color.height * sizeof(float));
    sherf_frame_free(&frame);
    sherf_frame_free(&again);
    sherf_avatar_free(both);
    sherf_avatar_free(loaded);
    sherf_model_free(m);
    sherf_observation_free(red);
    close_scene(&s);
}

/* A picture without the person is refused with its name. */
static void wrong_pictures_are_named(void **state) {
    scene s;
    sherf_model *m;
    sherf_avatar *a;
    open_scene(&s, SHERF_PRECISION_AUTO);
    sherf_camera away = s.camera;
    away.T_m[0] += 50;
    sherf_image mask = {s.camera.width_px, s.camera.height_px, 1, NULL};
    const size_t n = (size_t)mask.width * (size_t)mask.height;
    mask.data = mem_alloc(s.c, n, sizeof(float));
    for (size_t i = 0; i < n; i++) mask.data[i] = i > 0;
    sherf_observation *wrong;
    assert_ok(s.c, sherf_observation_create(s.c, sherf_observation_image(s.observation), &mask, &away,
                                            sherf_observation_pose(s.observation), &wrong));
    assert_ok(s.c, sherf_model_load(s.c, "../assets/models/people.safetensors", &m));
    const sherf_observation *given[] = {s.observation, wrong};
    assert_int_equal(sherf_avatar_create_several(s.c, m, s.body, 2, given, &a), SHERF_MISMATCH);
    assert_non_null(strstr(sherf_message(s.c), "picture 2: "));
    assert_null(a);
    mem_free(mask.data);
    sherf_observation_free(wrong);
    sherf_model_free(m);
    close_scene(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_side_is_its_pictures),
        cmocka_unit_test(wrong_pictures_are_named),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
