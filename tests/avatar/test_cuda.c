/* Tests of an avatar's file in a context with a GPU (here the emulation): loaded, placed and rendered through
 * the public functions, compared with the CPU. */
#include "support.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#ifdef HAVE_CUDA_EMULATED
#include "synth/tube/tubeman.h"
#include "avatar/avatar.h"
#include "model/sherf/fused/gpu.h"

extern const gpu_renderer gpu_renderer_emulated;

enum { SIDE = 32 };

static const char settings[] =
    "small,plane_resolution=16,channel_max=16,encoder_width=8,style_width=16,volume_channels0=8,"
    "volume_channels1=8,volume_channels2=16,decoder_width=32,decoder_depth=3,decoder_skip=1,view_width=16,"
    "samples=16,voxel_size_m=0.03,skin_blend_mm=20,occlusion=2";

static void avatar_write(context *c, const body_model *body, const char *path) {
    model_config config;
    model *m;
    sherf_avatar *a, *loaded;
    sherf_observation *observation;
    sherf_pose pose;
    sherf_camera camera;
    sherf_image image = {SIDE, SIDE, 3, mem_alloc(c, SIDE * SIDE * 3, sizeof(float))};
    sherf_image mask = {SIDE, SIDE, 1, mem_alloc(c, SIDE * SIDE, sizeof(float))};
    for (int i = 0; i < SIDE * SIDE * 3; i++) image.data[i] = (float)random_uniform(5, (uint64_t)i);
    for (int i = 0; i < SIDE * SIDE; i++) mask.data[i] = i % SIDE > 3 && i % SIDE < SIDE - 3;
    sherf_pose_identity(&pose);
    pose.poses_rad[3 * 16 + 2] = -0.9f;
    sherf_camera_orbit((float[]){0, 0.1f, 0}, 3, 0.3f, 0, 0.8f, SIDE, SIDE, &camera);
    assert_ok(c, model_config_parse(c, settings, &config));
    assert_ok(c, model_create(c, &config, 3, &m));
    float *density = tensor_f32(model_tensor(m, "decoder.alpha_linear.bias"));
    density[0] = 8; /* new weights alone show little */
    assert_ok(c, sherf_observation_create(c, &image, &mask, &camera, &pose, &observation));
    assert_ok(c, sherf_avatar_create(c, m, body, observation, &a));
    assert_ok(c, sherf_avatar_save(c, a, path));
    assert_ok(c, sherf_avatar_load(c, path, body, &loaded)); /* the file stores where points are read */
    assert_memory_equal(loaded->sheet.body->read_from, a->sheet.body->read_from,
                        (size_t)body->vertices * 12 * sizeof(float));
    sherf_avatar_free(loaded);
    sherf_avatar_free(a);
    sherf_observation_free(observation);
    model_free(m);
    mem_free(image.data);
    mem_free(mask.data);
}

/* plain: without the picture's detail; detailed: with it (NULL: not requested), through several renderings.
 */
static void render(context *c, const body_model *body, const char *path, sherf_frame *plain,
                   sherf_frame *detailed, size_t *values, float *sigma) {
    sherf_avatar *a;
    sherf_pose pose;
    sherf_camera camera;
    const sherf_render_options o = {.background = {0.2f, 0.5f, 1}, .exact = 1, .detail = SHERF_DETAIL_OFF};
    sherf_pose_identity(&pose);
    pose.poses_rad[3 * 17 + 2] = 0.7f;
    sherf_camera_orbit((float[]){0, 0.1f, 0}, 3, 1.1f, 0, 0.8f, 28, 32, &camera);
    assert_ok(c, sherf_avatar_load(c, path, body, &a));
    assert_int_equal(avatar_takes_joints(a), c->device == SHERF_DEVICE_CUDA);
    sherf_render_options sharp = o;
    sharp.detail = SHERF_DETAIL_ON;
    if (detailed) assert_ok(c, sherf_render(c, a, body, &pose, &camera, &sharp, detailed));
    assert_ok(c, sherf_render(c, a, body, &pose, &camera, &o, plain));
    /* and a query outside a frame */
    float at[3] = {0, 0.2f, 0.05f}, none[3] = {0, 0, 0}, px[2] = {20, 20}, rgb[3];
    const point_set one = {.count = 1, .canonical = at, .direction_canonical = none, .observed_px = px};
    assert_ok(c, avatar_query(c, a, body, &one, rgb, sigma));
    *values = a->field_kind->device_bytes(a->field);
    sherf_avatar_free(a);
}

static void avatars_agree(void **state) {
    context *c = test_context();
    body_model *body;
    sherf_frame want = {0}, got = {0}, want_sharp = {0}, got_sharp = {0};
    size_t bytes;
    float sigma, sigma_there;
    const char *path = test_path("avatar.safetensors");
    assert_ok(c, tubeman_create(c, &body));
    avatar_write(c, body, path);
    render(c, body, path, &want, &want_sharp, &bytes, &sigma);
    gpu_renderer_stand_in(&gpu_renderer_emulated);
    c->device = SHERF_DEVICE_CUDA;
    for (int bf16 = 0; bf16 < 2; bf16++) {
        c->precision = bf16 ? SHERF_PRECISION_BF16 : SHERF_PRECISION_FP32;
        render(c, body, path, &got, bf16 ? NULL : &got_sharp, &bytes, &sigma_there);
        const double color = test_psnr(&got.color, &want.color),
                     opacity = test_psnr(&got.opacity, &want.opacity);
        print_message("%s: %lld points, colour %.1f dB, opacity %.1f dB, %.1f MB there\n",
                      bf16 ? "bf16" : "float32", (long long)got.points, color, opacity, (double)bytes / 1e6);
        assert_int_equal(got.points, want.points);
        assert_true(want.points > 100);
        assert_true(color >= (bf16 ? 45 : 60) && opacity >= (bf16 ? 45 : 60));
        assert_true(fabsf(sigma_there - sigma) <= (bf16 ? 3e-2f : 1e-4f) * fabsf(sigma));
    }
    gpu_renderer_stand_in(NULL);
    const double sharp = test_psnr(&got_sharp.color, &want_sharp.color),
                 change = test_psnr(&want_sharp.color, &want.color);
    print_message("with detail (%.1f dB from without): colour %.1f dB\n", change, sharp);
    assert_true(sharp >= 60 && change < sharp - 40); /* the detail exists and is the same */
    sherf_frame_free(&want);
    sherf_frame_free(&got);
    sherf_frame_free(&want_sharp);
    sherf_frame_free(&got_sharp);
    sherf_body_free(body);
    sherf_context_free(c);
    assert_int_equal(mem_live(), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(avatars_agree)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
#else
int main(void) {
    printf("no C++ compiler: the CUDA kernels cannot be emulated\n");
    return 77;
}
#endif
