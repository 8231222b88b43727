/* One frame of a folder, or a list of frames, as JSON: EasyMocap, LHM, ExAvatar. */
#include <math.h>

#include "fuzz.h"
#include "motion/source.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    static const sherf_motion_options o;
    document *d;
    source s = {0};
    sherf_motion *m = NULL;
    sherf_pose pose;
    sherf_status status = json_parse(c, (const char *)data, size, &d);
    if (!status && frame_list_is(d->root)) {
        status = frame_list_read(c, d->root, &o, &s);
        if (!status) status = motion_finish(c, &s, &o, &m);
        if ((status == SHERF_OK) != (m != NULL)) abort();
    }
    if (m) sherf_motion_pose(m, sherf_motion_frame_count(m) / 2, &pose);
    for (int k = 0; k < 72 && m; k++)
        if (!isfinite(pose.poses_rad[k])) abort();
    sherf_motion_free(m);
    source_free(&s);
    document_free(d);
    return fuzz_end(c, status, live);
}
