/* Tests of the models beside SHERF on the emulated GPU (tests/support/cuda), against the processor's: the
 * losses of two steps, and frames of avatars from one file. */
#include "rival.h"

#ifdef HAVE_CUDA_EMULATED
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "base/device.h"

extern const backend backend_emulated;

static context *device_context(bool gpu) {
    context *c = test_context();
    if (gpu) c->device = SHERF_DEVICE_CUDA;
    return c;
}

static void frame_on(bool gpu, const char *preset, sherf_frame *frame) {
    context *c = device_context(false);
    sherf_body *body;
    sherf_avatar *a;
    const char *path = rival_avatar(c, preset, &body);
    sherf_context_free(c);
    c = device_context(gpu);
    const sherf_render_options exact = {.exact = 1, .detail = SHERF_DETAIL_OFF};
    assert_ok(c, sherf_avatar_load(c, path, body, &a));
    assert_ok(c, sherf_render(c, a, body, sherf_avatar_pose(a), sherf_avatar_camera(a), &exact, frame));
    sherf_avatar_free(a);
    sherf_body_free(body);
    sherf_context_free(c);
}

static void on_both(const char *preset) {
    double loss[2][2], worst = 0, seen = 0;
    sherf_frame frame[2] = {0};
    for (int gpu = 0; gpu < 2; gpu++) {
        context *c = device_context(gpu);
        rival_losses(c, preset, gpu ? "on_gpu" : "on_cpu", 2, loss[gpu]);
        sherf_context_free(c);
        frame_on(gpu, preset, &frame[gpu]);
    }
    const int pixels = frame[0].color.width * frame[0].color.height;
    for (int i = 0; i < 3 * pixels; i++)
        worst = fmax(worst, fabs((double)frame[0].color.data[i] - (double)frame[1].color.data[i]));
    for (int i = 0; i < pixels; i++) seen += (double)frame[0].opacity.data[i] / pixels;
    print_message("%s: losses %g, %g; pixels %.2g apart\n", preset, loss[0][0], loss[0][1], worst);
    for (int step = 0; step < 2; step++)
        if (!(fabs(loss[1][step] / loss[0][step] - 1) < 1e-3))
            fail_msg("step %d: %.9g on the GPU, %.9g", step, loss[1][step], loss[0][step]);
    assert_true(worst < 1e-4 && seen > 0.005);
    for (int k = 0; k < 2; k++) sherf_frame_free(&frame[k]);
    assert_int_equal(mem_live(), 0);
}

static void pixelnerf(void **state) {
    on_both("pixelnerf:own-small,encoder_width=8,width=16,pool=0,samples=6,passes=2,drawn=2,around=2");
}
#define VOLUME "volume_channels0=4,volume_channels1=4,volume_channels2=4,volume_channels3=4,voxel_size_m=0.08"
static void nhp(void **state) {
    on_both("nhp:own-small,encoder_width=8,width=16,samples=6," VOLUME);
}
static void mpsnerf(void **state) {
    on_both(
        "mps-nerf:own-small,encoder_width=8,value_width=24,mlp_width=16,width=16,view_width=8,samples=12");
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(pixelnerf), cmocka_unit_test(nhp),
                                       cmocka_unit_test(mpsnerf)};
    backend_stand_in(&backend_emulated);
    return cmocka_run_group_tests(tests, rival_data, NULL);
}
#else
int main(void) {
    print_message("skipped: there is no emulation of CUDA in this build\n");
    return 77;
}
#endif
