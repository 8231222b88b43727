/* Tests of rays for which the model's number of depths is too small: spread arms, seen along them. */
#include <math.h>
#include <string.h>

#include "demo_scene.h"

/* Arms spread. */
static const sherf_pose *rest(void) {
    static sherf_pose pose;
    sherf_pose_identity(&pose);
    return &pose;
}

static void camera_at(scene *s, double azimuth_deg, int size_px, sherf_camera *out) {
    const sherf_orbit_options o = {
        .azimuth_rad = azimuth_deg * M_PI / 180, .width_px = size_px, .height_px = size_px};
    assert_ok(s->c, sherf_cameras_orbit(s->c, s->body, rest(), 1, &o, 1, out));
}

static void render(scene *s, const sherf_camera *camera, int samples, sherf_frame *out) {
    const sherf_render_options o = {.samples = samples, .exact = 1, .detail = SHERF_DETAIL_OFF};
    assert_ok(s->c, sherf_render(s->c, s->avatar, s->body, rest(), camera, &o, out));
}

/* No step is too long, no ray has longer steps than before, and places in the box stay on their ray. */
static void steps_are_short(void **state) {
    scene s;
    sherf_camera side;
    posed_body *posed;
    ray_bundle *plain, *even;
    float min[3], max[3];
    open_scene(&s, SHERF_PRECISION_FP32);
    camera_at(&s, 90, 40, &side);
    assert_ok(s.c, avatar_pose(s.c, s.avatar, s.body, rest(), &posed));
    body_world_box(s.body, posed, min, max);
    assert_ok(s.c, rays_create(s.c, &side, min, max, &plain));
    const float longest_m = rays_extent(s.c, plain).longest_m;
    for (int samples_max = 60; samples_max <= 1024; samples_max += 964) {
        assert_ok(s.c, rays_create(s.c, &side, min, max, &even));
        const int count = rays_even_steps(s.c, even, longest_m, 48, samples_max, 0.012f);
        const double bound = samples_max == 60 ? 0.05 : 0.012;
        assert_true(count > 48 && count <= samples_max);
        int own = 0, cut = 0;
        for (int n = 0; n < 40 * 40; n++) {
            const float *d = even->direction + 3 * n;
            const double length = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
            const double before = (plain->far[n] - plain->near[n]) / 47.0;
            const double step = (even->far[n] - even->near[n]) / (count - 1.0);
            assert_true(even->near[n] == plain->near[n] && even->at_box[n] == plain->at_box[n]);
            if (!even->at_box[n]) continue;
            assert_true(step * length < bound * 1.0001 && step < before * 1.0001);
            assert_true(even->far[n] > plain->far[n] * 0.9999f); /* rays still pass through the whole box */
            own += step > before * 0.9999;
            cut += step < before * 0.9;
        }
        assert_true(cut > 20);
        assert_true(own + cut > 0);
        rays_free(even);
    }
    assert_ok(s.c, rays_create(s.c, &side, min, max, &even));
    assert_int_equal(rays_even_steps(s.c, even, longest_m, 48, 1024, 0.1f), 48); /* already short enough */
    assert_memory_equal(even->far, plain->far, 40 * 40 * sizeof(float));
    rays_free(even);
    rays_free(plain);
    posed_body_free(posed);
    close_scene(&s);
}

static void automatic_is_nearer_to_many(void **state) {
    scene s;
    sherf_camera side;
    sherf_frame own = {0}, automatic = {0}, many = {0};
    open_scene(&s, SHERF_PRECISION_FP32);
    camera_at(&s, 90, 96, &side);
    render(&s, &side, SHERF_SAMPLES_MODEL, &own);
    render(&s, &side, 0, &automatic);
    render(&s, &side, 320, &many);
    assert_true(automatic.points > own.points && automatic.points < many.points / 2);
    const double before = test_psnr(&own.color, &many.color),
                 after = test_psnr(&automatic.color, &many.color);
    if (!(after > before + 4)) fail_msg("%.1f dB, %.1f dB by the model's own number", after, before);
    for (int i = 0; i < 96 * 96; i++) /* the depth picture has no depths beyond the box */
        assert_true(automatic.depth.data[i] <= own.depth.data[0] || automatic.opacity.data[i] > 0);
    assert_true(automatic.depth.data[0] == own.depth.data[0]);
    sherf_frame_free(&own);
    sherf_frame_free(&automatic);
    sherf_frame_free(&many);
    close_scene(&s);
}

static void shallow_frames_keep_their_bits(void **state) {
    scene s;
    sherf_camera front;
    sherf_frame own = {0}, automatic = {0}, given = {0};
    open_scene(&s, SHERF_PRECISION_FP32);
    camera_at(&s, 0, 64, &front);
    render(&s, &front, SHERF_SAMPLES_MODEL, &own);
    render(&s, &front, SHERF_SAMPLES_AUTO, &automatic);
    render(&s, &front, 48, &given);
    assert_int_equal(automatic.points, own.points);
    assert_memory_equal(automatic.color.data, own.color.data, 64 * 64 * 3 * sizeof(float));
    assert_memory_equal(given.color.data, own.color.data, 64 * 64 * 3 * sizeof(float));
    const sherf_render_options wrong = {.samples = -3}, large = {.samples = 1025};
    assert_int_equal(sherf_render(s.c, s.avatar, s.body, rest(), &front, &wrong, &own), SHERF_BAD_ARGUMENT);
    assert_int_equal(sherf_render(s.c, s.avatar, s.body, rest(), &front, &large, &own), SHERF_BAD_ARGUMENT);
    sherf_frame_free(&own);
    sherf_frame_free(&automatic);
    sherf_frame_free(&given);
    close_scene(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(steps_are_short),
                                       cmocka_unit_test(automatic_is_nearer_to_many),
                                       cmocka_unit_test(shallow_frames_keep_their_bits)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
