/* Tests of the empty cells of canonical space, which frames skip, with the shipped model and the demo's
 * person. */
#include <math.h>
#include <string.h>

#include "demo_scene.h"

/* A frame's points with and without empty space, in the third pose's place. */
static void points_of(const scene *s, const occupancy_grid *empty, point_set **out) {
    const sherf_pose *pose = sherf_observation_pose(s->observation);
    const sherf_camera *camera = sherf_observation_camera(s->observation);
    sherf_camera small = *camera;
    camera_resize(&small, 96, 96);
    posed_body *posed;
    ray_bundle *rays;
    float min[3], max[3];
    assert_ok(s->c,
              posed_body_create(s->c, s->body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, &posed));
    body_world_box(s->body, posed, min, max);
    assert_ok(s->c, rays_create(s->c, &small, min, max, &rays));
    assert_ok(s->c, points_create(s->c, s->body, posed, rays, 48, s->avatar->sheet.body,
                                  &s->avatar->sheet.camera, empty, true, out));
    rays_free(rays);
    posed_body_free(posed);
}

static void what_is_left_out_has_no_density(void **state) {
    scene s;
    occupancy_grid empty;
    point_set *all, *kept;
    open_scene(&s, SHERF_PRECISION_FP32);
    assert_ok(s.c, occupancy_find(s.c, s.avatar, s.body, &empty));
    assert_non_null(empty.bit);
    points_of(&s, NULL, &all);
    points_of(&s, &empty, &kept);
    const int64_t dropped = all->count - kept->count;
    assert_true(dropped > all->count / 4 && dropped < all->count / 10 * 7);
    float *rgb = mem_alloc(s.c, (size_t)all->count, 3 * sizeof *rgb);
    float *sigma = mem_alloc(s.c, (size_t)all->count, sizeof *sigma);
    assert_true(rgb && sigma);
    assert_ok(s.c, avatar_query(s.c, s.avatar, s.body, all, rgb, sigma));
    int64_t at = 0;
    double lost = 0, whole = 0; /* sums of alpha per centimetre */
    for (int64_t i = 0; i < all->count; i++) {
        const double alpha = sigma[i] > 0 ? 1 - exp(-0.01 * (double)sigma[i]) : 0;
        if (at < kept->count && kept->ray[at] == all->ray[i] && kept->sample[at] == all->sample[i]) {
            assert_int_equal(kept->nearest[at], all->nearest[i]);
            assert_memory_equal(kept->canonical + 3 * at, all->canonical + 3 * i, 3 * sizeof(float));
            assert_memory_equal(kept->observed_px + 2 * at, all->observed_px + 2 * i, 2 * sizeof(float));
            at++;
        } else {
            lost += alpha;
        }
        whole += alpha;
    }
    assert_int_equal(at, kept->count); /* a subset of all points, in order */
    if (!(lost < 1e-3 * whole)) fail_msg("%g of %g is left out", lost, whole);
    for (int64_t n = 0; n < kept->rays; n++) assert_true(kept->first[n] <= kept->first[n + 1]);
    assert_int_equal(kept->first[kept->rays], kept->count);
    mem_free(rgb);
    mem_free(sigma);
    points_free(all);
    points_free(kept);
    occupancy_free(&empty);
    close_scene(&s);
}

/* A frame in which only empty space is skipped, as on a GPU and in small pictures. */
static void frame_without_empty(const scene *s, sherf_frame *frame) {
    static const float black[3];
    const sherf_camera *camera = sherf_observation_camera(s->observation);
    posed_body *posed;
    ray_bundle *rays;
    point_set *points;
    float min[3], max[3];
    assert_ok(s->c, avatar_pose(s->c, s->avatar, s->body, sherf_observation_pose(s->observation), &posed));
    body_world_box(s->body, posed, min, max);
    assert_ok(s->c, rays_create(s->c, camera, min, max, &rays));
    rays_repair(s->c, rays, min, max);
    const float longest_m = rays_extent(s->c, rays).longest_m;
    const int samples = rays_even_steps(s->c, rays, longest_m, s->avatar->config.samples, 1024, 0.012f);
    assert_ok(s->c, points_create(s->c, s->body, posed, rays, samples, s->avatar->sheet.body,
                                  &s->avatar->sheet.camera, &s->avatar->occupancy->cells, false, &points));
    assert_ok(s->c, avatar_composite(s->c, s->avatar, s->body, rays, points, black, false, frame));
    points_free(points);
    rays_free(rays);
    posed_body_free(posed);
}

static void check_frames(sherf_precision precision) {
    scene s;
    open_scene(&s, precision);
    sherf_frame frame[2] = {0};
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF},
                               plain = {.detail = SHERF_DETAIL_OFF};
    const sherf_pose *pose = sherf_observation_pose(s.observation);
    const sherf_camera *camera = sherf_observation_camera(s.observation);
    assert_ok(s.c, sherf_render(s.c, s.avatar, s.body, pose, camera, &exact, &frame[0]));
    assert_false(s.avatar->occupancy->looked);
    assert_ok(s.c, sherf_render(s.c, s.avatar, s.body, pose, camera, &plain, &frame[1]));
    frame_without_empty(&s, &frame[1]);
    assert_true(s.avatar->occupancy->looked && frame[1].points < frame[0].points / 4 * 3);
    double sum = 0;
    const int64_t n = (int64_t)camera->width_px * camera->height_px * 3;
    for (int64_t i = 0; i < n; i++) sum += pow(frame[0].color.data[i] - frame[1].color.data[i], 2);
    const double psnr = -10 * log10(sum / (double)n);
    if (!(psnr > 60)) fail_msg("%.1f dB", psnr);
    for (int i = 0; i < 2; i++) sherf_frame_free(&frame[i]);
    close_scene(&s);
}

static void frames_hardly_differ(void **state) {
    check_frames(SHERF_PRECISION_FP32);
}
static void frames_in_bf16_hardly_differ(void **state) {
    skip_without_bf16();
    check_frames(SHERF_PRECISION_BF16);
}

/* A model that is dense everywhere: no cell is empty, and no bits are kept. */
static void a_full_body_has_no_cells(void **state) {
    scene s;
    occupancy_grid empty;
    open_scene(&s, SHERF_PRECISION_FP32);
    tensor *bias = &parameter_find(s.avatar->weights, "decoder.alpha_linear.bias")->value;
    tensor_f32(bias)[0] += 1e4f;
    s.avatar->field_kind->release(s.avatar->field);
    assert_ok(s.c, avatar_place(s.c, s.body, s.avatar));
    assert_ok(s.c, occupancy_find(s.c, s.avatar, s.body, &empty));
    assert_null(empty.bit);
    close_scene(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(what_is_left_out_has_no_density), cmocka_unit_test(frames_hardly_differ),
        cmocka_unit_test(frames_in_bf16_hardly_differ), cmocka_unit_test(a_full_body_has_no_cells)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
