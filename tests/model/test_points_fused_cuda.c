/* Tests of the radiance field's fused training path with the kernels of src/model/sherf/cuda, on a GPU or on
 * the host (tests/support/cuda), against the processor's ops in float32: densities, colours and the gradients
 * of all inputs; and with threads and blocks in the opposite order, the same bits. */
enum { SIDE = 40, WITHOUT = 1 };
#include "points_fused_pass.h"

#if defined(HAVE_CUDA_EMULATED)
#include "base/device.h"
#include "model/sherf/fused/gpu.h"

extern const backend backend_emulated;
extern const gpu_renderer gpu_renderer_emulated;
extern int cuda_emulated_order;

/* One pass on the GPU. */
static int64_t pass_there(scene *s, float *frame, float **gradients) {
    context *c = s->c;
    c->device = SHERF_DEVICE_CUDA;
    const backend *there = backend_of(c);
    model *m = weights_in(c, &s->m->config, there->memory);
    tape *t = tape_create(c, (tape_options){there, true, true, true});
    assert_non_null(t);
    assert_non_null(gpu_renderer_of(c));
    assert_ptr_equal(gpu_renderer_of(c)->memory,
                     there->memory); /* otherwise the path would not be the fused one */
    tape_free(t);
    const int64_t n = pass(s, m, there, true, frame, gradients);
    model_free(m);
    c->device = SHERF_DEVICE_CPU;
    return n;
}

static void agrees(const char *config) {
    scene s = {0};
    scene_open(&s, config);
    static float frame[4][SIDE * SIDE * 5];
    float *fused, *again, *rounded, *exact;
    backend ops = backend_cpu; /* a copy, which is not the backend that fuses */
    print_message("%lld points\n", (long long)s.target->points->count);
    const int64_t n = pass(&s, s.m, &ops, false, frame[2], &exact);
    ops_round(&ops);
    assert_int_equal(pass(&s, s.m, &ops, false, frame[1], &rounded), n);
    assert_int_equal(pass_there(&s, frame[0], &fused), n);
    no_worse("frame", frame[0], frame[1], frame[2], SIDE * SIDE * 5);
    no_worse_all(&s, fused, rounded, exact, n);
    cuda_emulated_order = 1;
    assert_int_equal(pass_there(&s, frame[3], &again), n);
    cuda_emulated_order = 0;
    assert_memory_equal(frame[0], frame[3], sizeof frame[0]);
    assert_memory_equal(fused, again, (size_t)n * sizeof *fused);
    mem_free(fused);
    mem_free(again);
    mem_free(rounded);
    mem_free(exact);
    scene_close(&s);
    assert_int_equal(mem_live(), 0);
}

static void narrow_agrees(void **state) {
    agrees(
        "small,plane_resolution=16,decoder_width=40,decoder_depth=3,decoder_skip=0,view_width=24,samples=24");
}
static void paper_agrees(void **state) {
    agrees("paper,plane_resolution=16,voxel_size_m=0.03,channel_max=16,encoder_width=8,style_width=16,"
           "samples=12");
}

int main(void) {
    char line[160];
    if (!device_gpu_present(line, sizeof line)) {
        backend_stand_in(&backend_emulated);
        gpu_renderer_stand_in(&gpu_renderer_emulated);
    }
    const struct CMUnitTest tests[] = {cmocka_unit_test(narrow_agrees), cmocka_unit_test(paper_agrees)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
#else
int main(void) {
    puts("skipped: there was no C++ compiler for the emulated kernels");
    return 77;
}
#endif
