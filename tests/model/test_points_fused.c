/* The radiance field's fused way through training (bf16) against the ops in float32: densities, colours and
 * the gradients of all that goes in. */
enum { SIDE = 96, WITHOUT = 0 };
#include "points_fused_pass.h"

static void agrees(const char *config) {
    scene s = {0};
    scene_open(&s, config);
    static float frame[3][SIDE * SIDE * 5];
    float *fused, *rounded, *exact;
    backend ops = backend_cpu; /* another than the one that fuses */
    int64_t n = pass(&s, s.m, &backend_cpu, true, frame[0], &fused);
    assert_int_equal(pass(&s, s.m, &ops, false, frame[2], &exact), n);
    ops_round(&ops);
    assert_int_equal(pass(&s, s.m, &ops, false, frame[1], &rounded), n);
    no_worse("frame", frame[0], frame[1], frame[2], SIDE * SIDE * 5);
    no_worse_all(&s, fused, rounded, exact, n);
    mem_free(fused);
    mem_free(rounded);
    mem_free(exact);
    scene_close(&s);
}

static void small_agrees(void **state) {
    agrees("small,plane_resolution=32");
}
static void paper_agrees(void **state) {
    agrees("paper,plane_resolution=32,voxel_size_m=0.02,channel_max=32,encoder_width=8,style_width=32");
}

int main(void) {
    if (!isa_has_bf16()) {
        printf("skipped: the fused way is for bf16, which needs AMX; this is %s\n", isa_name(isa_best()));
        return 77;
    }
    const struct CMUnitTest tests[] = {cmocka_unit_test(small_agrees), cmocka_unit_test(paper_agrees)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
