/* Fuzz target: BVH motions. */
#include "fuzz.h"
#include "io/bvh.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    volatile double sum = 0;
    bvh *b;
    sherf_status status = bvh_parse(c, data, size, &b);
    if ((status == SHERF_OK) != (b != NULL)) abort();
    if (b) {
        double global[BVH_JOINTS_MAX * 9], root[3];
        bvh_rotations(b, b->frames - 1, NULL, global);
        bvh_root_position(b, 0, root);
        for (int i = 0; i < b->joints * 9; i++) sum += global[i];
        sum += root[0];
    }
    (void)sum;
    bvh_free(b);
    return fuzz_end(c, status, live);
}
