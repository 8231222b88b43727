/* Fuzz target: baked avatars. */
#include "baked/form.h"
#include "fuzz.h"
#include "synth/tube/tubeman.h"

enum { SIDE = 96 };

/* The file of a baked avatar of any body. Avatars that can be read are drawn from two sides, so that every
 * index that the reader accepts is used. Seen from nearby, edges are softened. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static body_model *body;
    context *c = fuzz_context();
    if (!body && tubeman_create(c, &body) != SHERF_OK) abort();
    const size_t live = mem_live();
    safetensors *file;
    sherf_avatar *a = NULL;
    sherf_status status = safetensors_parse(c, data, size, &file);
    if (status == SHERF_OK) {
        const char *whose = safetensors_metadata(file, "body");
        if (whose) body->fingerprint = strtoull(whose, NULL, 16);
        status = baked_read(c, file, body, &a);
        if ((status == SHERF_OK) != (a != NULL)) abort();
        safetensors_free(file);
    }
    for (int i = 0; i < 2 && a && ((const baked_form *)a->formed)->side_px <= 256; i++) {
        const sherf_pose *pose = sherf_avatar_pose(a);
        sherf_camera camera;
        sherf_frame frame = {0};
        sherf_camera_orbit(pose->Th_m, i ? 0.8f : 3, (float)i, 0.2f, 0.7f, SIDE, SIDE, &camera);
        if (sherf_render(c, a, body, pose, &camera, NULL, &frame) == SHERF_OK) {
            volatile uint64_t sum = fuzz_sum(frame.color.data, sizeof(float) * 3 * SIDE * SIDE);
            sum += fuzz_sum(frame.opacity.data, sizeof(float) * SIDE * SIDE);
            for (int k = 0; k < SIDE * SIDE; k++)
                if (!(frame.opacity.data[k] >= 0 && frame.opacity.data[k] <= 1.0001f)) abort();
            (void)sum;
        }
        sherf_frame_free(&frame);
    }
    sherf_avatar_free(a);
    return fuzz_end(c, status, live);
}
