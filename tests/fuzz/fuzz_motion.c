/* Fuzz target: motion files of all families. Every returned motion can be played to its end. The first byte
 * chooses the options. */
#include <math.h>

#include "fuzz.h"
#include "motion/source.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    uint8_t bits = size ? data[0] : 0;
    sherf_pose pose;
    sherf_pose_identity(&pose);
    const sherf_motion_options o = {.loop = bits & 1,
                                    .fps = bits & 2 ? 7 : 0,
                                    .start = bits & 4 ? &pose : NULL,
                                    .blend_s = 0.3,
                                    .root =
                                        (sherf_root)(bits >> 3 & 1 ? SHERF_ROOT_GROUNDED : SHERF_ROOT_KEPT),
                                    .smooth_s = bits & 16 ? 0.01 : 0,
                                    .their_shape = bits & 32,
                                    .rotations = (sherf_rotations)(bits >> 6)};
    sherf_motion *motion;
    if (!size) return 0;
    sherf_status status = motion_parse(c, data + 1, size - 1, &o, &motion);
    if ((status == SHERF_OK) != (motion != NULL)) abort();
    if (motion && (sherf_motion_frame_count(motion) < 1 || !(sherf_motion_fps(motion) > 0))) abort();
    int step = motion ? sherf_motion_frame_count(motion) / 50 + 1 : 1;
    for (int i = 0; motion && i < sherf_motion_frame_count(motion); i += step) {
        sherf_motion_pose(motion, i, &pose);
        for (int k = 0; k < 72; k++)
            if (!isfinite(pose.poses_rad[k]) || !isfinite(pose.Th_m[k % 3])) abort();
    }
    sherf_motion_free(motion);
    return fuzz_end(c, status, live);
}
