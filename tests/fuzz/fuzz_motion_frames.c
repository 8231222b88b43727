/* Fuzz target: one frame of a folder, or a list of frames, as JSON (EasyMocap, LHM, ExAvatar). */
#include <math.h>

#include "fuzz.h"
#include "motion/source.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    static const sherf_motion_options o;
    document *d;
    source s = {0};
    sherf_motion *motion = NULL;
    sherf_pose pose;
    sherf_status status = json_parse(c, (const char *)data, size, &d);
    if (!status && frame_list_is(d->root)) {
        status = frame_list_read(c, d->root, &o, &s);
        if (!status) status = motion_finish(c, &s, &o, &motion);
        if ((status == SHERF_OK) != (motion != NULL)) abort();
    }
    if (motion) sherf_motion_pose(motion, sherf_motion_frame_count(motion) / 2, &pose);
    for (int k = 0; k < 72 && motion; k++)
        if (!isfinite(pose.poses_rad[k])) abort();
    sherf_motion_free(motion);
    source_free(&s);
    document_free(d);
    return fuzz_end(c, status, live);
}
