/* Fuzz target: pose files with one frame or many, as JSON in all its layouts and everything else that
 * document_read accepts. */
#include <math.h>

#include "data/parse.h"
#include "fuzz_folder.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    const char *path = fuzz_file("poses.json", data, size);
    const size_t live = mem_live();
    sherf_pose *pose = NULL;
    int count = 0;
    sherf_status status = sherf_poses_load(c, path, &pose, &count);
    if ((status == SHERF_OK) != (pose != NULL && count > 0)) abort();
    for (int i = 0; i < count; i++) {
        const sherf_pose *p = &pose[i];
        for (int k = 0; k < 72; k++)
            if (!isfinite(p->poses_rad[k]) || !isfinite(p->shapes[k % 10]) || !isfinite(p->Th_m[k % 3]))
                abort();
        if (rotation_check(c, p->R, "R") != SHERF_OK) abort();
    }
    mem_free(pose);
    return fuzz_end(c, status, live);
}
