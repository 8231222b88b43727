/* Tests of frames by the kernels of src/sampling/cuda, on the host (tests/support/cuda) or on a GPU, against
 * the CPU's: the same points to the bit, the network and the pictures within their bounds; and with threads
 * and blocks in the opposite order, the same bits. */
#include "support.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "../model/radiance_field_made.h"

#if defined(HAVE_CUDA_EMULATED)
#include "base/device.h"
#include "synth/tube/tubeman.h"
#include "model/sherf/fused/gpu.h"

extern const gpu_renderer gpu_renderer_emulated;
extern int cuda_emulated_order;

typedef struct {
    context *c;
    body_model *body;
    posed_body *seen;
    sherf_camera seen_by;
    const gpu_renderer *gpu;
} scene;

static const gpu_renderer *renderer(void) {
#ifdef SHERF_HAVE_CUDA
    char line[160];
    if (device_gpu_present(line, sizeof line)) {
        print_message("on %s\n", line);
        return &gpu_renderer_cuda;
    }
#endif
    return &gpu_renderer_emulated;
}

static void pose_of(float angle_rad, sherf_pose *out) {
    sherf_pose_identity(out);
    for (int i = 0; i < 9; i++) out->R[i] = 0; /* turned about y and x */
    out->R[1] = 1, out->R[5] = 1, out->R[6] = 1;
    out->Th_m[0] = 0.3f, out->Th_m[2] = -0.2f;
    out->poses_rad[3 * 16 + 2] = -1.1f;
    out->poses_rad[3 * 17 + 1] = angle_rad;
    out->poses_rad[3 * 1] = -angle_rad;
    out->poses_rad[3 * 5] = angle_rad / 2;
    out->shapes[0] = 1, out->shapes[3] = -0.5f;
}

static void scene_open(scene *s) {
    context *c = s->c = test_context();
    sherf_pose pose;
    s->gpu = renderer();
    assert_ok(c, tubeman_create(c, &s->body));
    pose_of(0.2f, &pose);
    assert_ok(c, posed_body_create(c, s->body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &s->seen));
    s->seen->blend_m = 0.02f;
    sherf_camera_orbit(pose.Th_m, 3, 0.3f, 0, 0.7f, 64, 48, &s->seen_by);
    assert_ok(c, body_read_pictures(c, s->body, 1, &(body_picture){s->seen, &s->seen_by, NULL, NULL}, true,
                                    s->seen));
}

static void scene_close(scene *s) {
    posed_body_free(s->seen);
    sherf_body_free(s->body);
    sherf_context_free(s->c);
    assert_int_equal(mem_live(), 0);
}

static gpu_avatar *avatar(scene *s, const made *fixture, bool bf16) {
    radiance_parts parts;
    gpu_avatar *a;
    assert_ok(s->c, radiance_parts_create(s->c, &fixture->s, &fixture->w, &fixture->bank, &parts));
    assert_ok(s->c, s->gpu->place(s->c, s->body, s->seen, &s->seen_by, &parts, bf16, &a));
    radiance_parts_free(&parts);
    return a;
}

/* Makes the target twice: one for the CPU, and its joints for the GPU. */
static void target_pose(scene *s, float angle_rad, float blend_m, posed_body **whole, posed_body **joints) {
    sherf_pose pose;
    pose_of(angle_rad, &pose);
    assert_ok(s->c, posed_body_create(s->c, s->body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, whole));
    assert_ok(s->c,
              posed_joints_create(s->c, s->body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, joints));
    (*whole)->blend_m = (*joints)->blend_m = blend_m;
}

static void camera_at(float azimuth_rad, int width, int height, sherf_camera *out) {
    sherf_camera_orbit((float[]){0.3f, 0.1f, -0.2f}, 2.6f, azimuth_rad, 0.1f, 0.8f, width, height, out);
}

/* Every other cell of a coarse lattice. */
static void some_empty(scene *s, occupancy_grid *e) {
    float max[3];
    *e = (occupancy_grid){.per_m = 20};
    body_canonical_bounds(s->body, e->min, max);
    for (int k = 0; k < 3; k++) e->cells[k] = (int)((max[k] - e->min[k]) * e->per_m) + 1;
    e->words = (e->cells[0] + 31) / 32;
    size_t words = (size_t)e->words * (size_t)e->cells[1] * (size_t)e->cells[2];
    e->bit = mem_alloc(s->c, words, sizeof *e->bit);
    for (size_t i = 0; i < words; i++) e->bit[i] = 0x5a5a5a5au;
}

static double farthest(const float *a, const float *b, int64_t n) {
    double largest = 0;
    for (int64_t i = 0; i < n; i++) largest = fmax(largest, fabs((double)a[i] - b[i]));
    return largest;
}

static void check_points(scene *s, gpu_avatar *a, float angle_rad, float blend_m, int samples, float step_m,
                         bool empty) {
    context *c = s->c;
    posed_body *whole, *joints;
    sherf_camera camera;
    ray_bundle *rays;
    point_set *want, *got;
    float min[3], max[3];
    occupancy_grid cells = {0};
    if (empty) some_empty(s, &cells);
    target_pose(s, angle_rad, blend_m, &whole, &joints);
    camera_at(1.1f + angle_rad, 52, 44, &camera);
    body_world_box(s->body, whole, min, max);
    assert_ok(c, rays_create(c, &camera, min, max, &rays));
    if (step_m > 0) rays_repair(c, rays, min, max);
    const float longest_m = rays_extent(c, rays).longest_m;
    const int even = step_m > 0 ? rays_even_steps(c, rays, longest_m, samples, 100, step_m) : samples;
    assert_true((even > samples) == (step_m > 0));
    assert_ok(c, points_create(c, s->body, whole, rays, even, s->seen, &s->seen_by, &cells, true, &want));
    gpu_frame_options o = {.samples = samples,
                           .samples_max = step_m > 0 ? 100 : 0,
                           .step_max_m = step_m,
                           .repair = step_m > 0,
                           .empty = empty ? &cells : NULL};
    assert_ok(c, s->gpu->points(c, a, joints, &camera, &o, &got));
    assert_int_equal(got->count, want->count);
    assert_int_equal(got->samples, even);
    assert_true(want->count > 300);
    assert_memory_equal(got->first, want->first, (size_t)(want->rays + 1) * sizeof *want->first);
    assert_memory_equal(got->ray, want->ray, (size_t)want->count * sizeof *want->ray);
    assert_memory_equal(got->sample, want->sample, (size_t)want->count * sizeof *want->sample);
    assert_memory_equal(got->nearest, want->nearest, (size_t)want->count * sizeof *want->nearest);
    const double place = farthest(got->canonical, want->canonical, 3 * want->count),
                 direction = farthest(got->direction_canonical, want->direction_canonical, 3 * want->count),
                 px = farthest(got->observed_px, want->observed_px, 2 * want->count);
    print_message("%lld points, blend %g, %d samples%s: places %.1e m, directions %.1e, pixels %.1e\n",
                  (long long)want->count, (double)blend_m, even, empty ? ", some empty" : "", place,
                  direction, px);
    assert_true(place <= 1e-6 && direction <= 1e-6 && px <= 1e-3);
    points_free(got);
    points_free(want);
    rays_free(rays);
    posed_body_free(whole);
    posed_body_free(joints);
    mem_free(cells.bit);
}

static void points_agree(void **state) {
    scene s;
    made fixture;
    scene_open(&s);
    made_create(&fixture, &made_odd, 12, 24, 0.03f, 8, 8, 12);
    gpu_avatar *a = avatar(&s, &fixture, false);
    check_points(&s, a, 0.5f, 0, 48, 0, false);
    check_points(&s, a, -0.6f, 0.02f, 33, 0, true);
    check_points(&s, a, -0.6f, 0.02f, 12, 0.03f, false);
    s.gpu->release(a);
    made_free(&fixture);
    scene_close(&s);
}

/* The CPU's values for the points of a made-up network. */
static void host_values(context *c, const made *fixture, float **rgb, float **sigma) {
    radiance_field *n;
    *rgb = mem_alloc(c, (size_t)fixture->points.count, 3 * sizeof(float));
    *sigma = mem_alloc(c, (size_t)fixture->points.count, sizeof(float));
    assert_ok(c, radiance_field_create(c, &fixture->s, &fixture->w, &fixture->bank, false, &n));
    assert_ok(c, radiance_field_run(c, n, &fixture->points, *rgb, *sigma));
    radiance_field_free(n);
}

/* Largest and root mean square difference over the largest value. */
static void compare(const float *got, const float *want, int64_t n, double *worst, double *rms) {
    double top = 0, sum = 0, largest = 0;
    for (int64_t i = 0; i < n; i++) {
        const double d = fabs((double)got[i] - want[i]);
        top = fmax(top, fabs(want[i]));
        sum += d * d;
        largest = d >= 0 ? fmax(largest, d) : INFINITY; /* not a number */
    }
    *worst = largest / top;
    *rms = sqrt(sum / (double)n) / top;
}

static void check_network(scene *s, const radiance_sizes *sizes, int side, bool bf16, bool fits,
                          double worst_allowed, double rms_allowed) {
    context *c = s->c;
    made fixture;
    float *rgb[2], *sigma[2], *want_rgb, *want_sigma;
    made_create(&fixture, sizes, 24, 32, 0.04f, side, side, 12);
    const int64_t n = fixture.points.count;
    fixture.points.canonical[0] = NAN; /* such a point does not harm others */
    host_values(c, &fixture, &want_rgb, &want_sigma);
    gpu_avatar *a = avatar(s, &fixture, bf16);
    assert_int_equal(s->gpu->in_bf16(a), bf16 && fits);
    for (int order = 0; order < 2; order++) {
        rgb[order] = mem_alloc(c, (size_t)n, 3 * sizeof(float));
        sigma[order] = mem_alloc(c, (size_t)n, sizeof(float));
        cuda_emulated_order = order;
        assert_ok(c, s->gpu->run(c, a, &fixture.points, rgb[order], sigma[order]));
    }
    cuda_emulated_order = 0;
    assert_memory_equal(rgb[0] + 3, rgb[1] + 3, (size_t)(n - 1) * 3 * sizeof(float));
    assert_memory_equal(sigma[0] + 1, sigma[1] + 1, (size_t)(n - 1) * sizeof(float));
    double worst[2], rms[2];
    compare(rgb[0] + 3, want_rgb + 3, 3 * (n - 1), &worst[0], &rms[0]);
    compare(sigma[0] + 1, want_sigma + 1, n - 1, &worst[1], &rms[1]);
    print_message("%lld points, %s, decoder %d: colour %.1e (rms %.1e), density %.1e (rms %.1e)\n",
                  (long long)n, bf16 && fits ? "bf16" : "float32", fixture.s.decoder_width, worst[0], rms[0],
                  worst[1], rms[1]);
    for (int i = 0; i < 2; i++) assert_true(worst[i] <= worst_allowed && rms[i] <= rms_allowed);
    for (int k = 0; k < 2; k++) {
        mem_free(rgb[k]);
        mem_free(sigma[k]);
    }
    mem_free(want_rgb);
    mem_free(want_sigma);
    s->gpu->release(a);
    made_free(&fixture);
}

static void float_network_agrees(void **state) {
    scene s;
    scene_open(&s);
    check_network(&s, &made_paper, 20, false, true, 2e-5, 2e-6);
    check_network(&s, &made_odd, 14, true, false, 2e-5, 2e-6); /* tokens of 24 do not suit bf16 */
    scene_close(&s);
}

static void bf16_network_agrees(void **state) {
    scene s;
    scene_open(&s);
    check_network(&s, &made_paper, 14, true, true, 4e-2, 8e-3);
    /* more tiles than blocks */
    check_network(&s, &made_narrow, 40, true, true, 4e-2, 8e-3);
    scene_close(&s);
}

static void check_frame(scene *s, const made *fixture, bool bf16, bool early_stop, double psnr_needed) {
    context *c = s->c;
    posed_body *whole, *joints;
    sherf_camera camera;
    ray_bundle *rays;
    point_set *points;
    radiance_field *n;
    sherf_frame want = {0}, got = {0}, again = {0};
    float min[3], max[3];
    gpu_frame_options o = {.samples = 24, .background = {0.2f, 0.4f, 1}, .early_stop = early_stop};
    target_pose(s, 0.5f, 0.02f, &whole, &joints);
    camera_at(0.7f, 26, 22, &camera);
    body_world_box(s->body, whole, min, max);
    assert_ok(c, rays_create(c, &camera, min, max, &rays));
    assert_ok(c,
              points_create(c, s->body, whole, rays, o.samples, s->seen, &s->seen_by, NULL, false, &points));
    assert_ok(c, radiance_field_create(c, &fixture->s, &fixture->w, &fixture->bank, false, &n));
    assert_ok(c, radiance_field_render(c, n, rays, points, o.background, false, &want));
    gpu_avatar *a = avatar(s, fixture, bf16);
    assert_ok(c, s->gpu->render(c, a, joints, &camera, &o, &got));
    assert_int_equal(got.points, points->count);
    cuda_emulated_order = 1;
    assert_ok(c, s->gpu->render(c, a, joints, &camera, &o, &again));
    cuda_emulated_order = 0;
    const size_t pixels = (size_t)rays->width * (size_t)rays->height;
    assert_memory_equal(got.color.data, again.color.data, 3 * pixels * sizeof(float));
    assert_memory_equal(got.opacity.data, again.opacity.data, pixels * sizeof(float));
    assert_memory_equal(got.depth.data, again.depth.data, pixels * sizeof(float));
    const double color = test_psnr(&got.color, &want.color), opacity = test_psnr(&got.opacity, &want.opacity),
                 depth = farthest(got.depth.data, want.depth.data, (int64_t)pixels);
    print_message("%lld points, %s%s: colour %.1f dB, opacity %.1f dB, depth within %.1e m\n",
                  (long long)got.points, bf16 ? "bf16" : "float32", early_stop ? ", early stop" : "", color,
                  opacity, depth);
    assert_true(color >= psnr_needed && opacity >= psnr_needed && depth < (bf16 ? 0.5 : 1e-4));
    s->gpu->release(a);
    sherf_frame_free(&want);
    sherf_frame_free(&got);
    sherf_frame_free(&again);
    radiance_field_free(n);
    points_free(points);
    rays_free(rays);
    posed_body_free(whole);
    posed_body_free(joints);
}

static void frames_agree(void **state) {
    scene s;
    made fixture;
    scene_open(&s);
    made_create(&fixture, &made_narrow, 24, 32, 0.04f, 8, 8, 12);
    check_frame(&s, &fixture, false, false, 60);
    check_frame(&s, &fixture, true, true, 45);
    made_free(&fixture);
    scene_close(&s);
}

/* A pose that is too large, and a camera that sees nothing. */
static void refusals(void **state) {
    scene s;
    made fixture;
    posed_body *whole, *joints;
    sherf_camera camera;
    sherf_frame frame = {0};
    gpu_frame_options o = {.samples = 12};
    scene_open(&s);
    made_create(&fixture, &made_odd, 12, 24, 0.03f, 8, 8, 12);
    gpu_avatar *a = avatar(&s, &fixture, false);
    target_pose(&s, 0.5f, 0, &whole, &joints);
    camera_at(0.7f, 20, 20, &camera);
    camera.T_m[2] = -5; /* the person is behind it */
    assert_ok(s.c, s.gpu->render(s.c, a, joints, &camera, &o, &frame));
    assert_int_equal(frame.points, 0);
    for (int i = 0; i < 400; i++) assert_true(frame.opacity.data[i] == 0);
    joints->joints->transform[0][3] = 1e9;
    assert_int_equal(s.gpu->render(s.c, a, joints, &camera, &o, &frame), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(s.c->message, "1000 km"));
    sherf_frame_free(&frame);
    s.gpu->release(a);
    posed_body_free(whole);
    posed_body_free(joints);
    made_free(&fixture);
    scene_close(&s);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(points_agree), cmocka_unit_test(float_network_agrees),
                                       cmocka_unit_test(bf16_network_agrees), cmocka_unit_test(frames_agree),
                                       cmocka_unit_test(refusals)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
#else
int main(void) {
    printf("no C++ compiler: the CUDA kernels cannot be emulated\n");
    return 77;
}
#endif
