/* Tests of the radiance field's fused training path against the ops in float32: densities, colours and the
 * gradients of all inputs. */
enum { SIDE = 96, WITHOUT = 0 };
#include "points_fused_pass.h"

static void agrees(const char *config) {
    scene s = {0};
    scene_open(&s, config);
    static float frame[3][SIDE * SIDE * 5];
    float *fused, *rounded, *exact;
    backend ops = backend_cpu; /* a copy, which is not the backend that fuses */
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

/* Sums in float32 in a different order, and functions accurate to a few units in the last place: as close to
 * the ops as that allows. */
static void equals(const char *name, const float *fused, const float *exact, int64_t n) {
    const double a = off(fused, exact, n);
    if (getenv("SHERF_TEST_VERBOSE")) printf("%-56s %.2e\n", name, a);
    if (!(a < 5e-6)) fail_msg("%s: %g from the ops", name, a);
}

/* Moves every ReLU of every point away from its kink. Near the kink, two orders of summation may disagree on
 * whether it lets the value through, and the gradient of that point would differ. */
static void decide(const parameters *p) {
    for (int i = 0; i < p->count; i++) {
        tensor *x = &p->item[i]->value;
        const char *name = p->item[i]->name;
        const bool bias = x->rank == 1, alpha = strstr(name, "alpha_linear") != NULL;
        if (!alpha && !strstr(name, "pts_linears") && !strstr(name, "views_linear")) continue;
        for (int64_t k = 0; k < tensor_count(x); k++) {
            float *value = tensor_f32(x) + k;
            *value = alpha && bias ? 1.0f : alpha ? *value : !bias ? 0.2f * *value : k % 2 ? 1.0f : -1.0f;
        }
    }
}

static void agrees_float(const char *config) {
    scene s = {0};
    scene_open(&s, config);
    static float frame[2][SIDE * SIDE * 5];
    float *fused, *again, *exact;
    backend ops = backend_cpu; /* a copy, which is not the backend that fuses */
    const parameters *p = s.m->weights;
    decide(p);
    int64_t n = pass(&s, s.m, &backend_cpu, false, frame[0], &fused);
    s.c->threads = 5; /* the same bits as with any other number of threads */
    assert_int_equal(pass(&s, s.m, &backend_cpu, false, frame[1], &again), n);
    assert_memory_equal(frame[0], frame[1], sizeof frame[0]);
    assert_memory_equal(fused, again, (size_t)n * sizeof *again);
    assert_int_equal(pass(&s, s.m, &ops, false, frame[1], &exact), n);
    equals("frame", frame[0], frame[1], SIDE * SIDE * 5);
    for (int i = 0; i < p->count; i++) {
        const parameter *q = p->item[i];
        if (!q->buffer && model_is_queried(s.m->config.kind, q->name))
            equals(q->name, fused + q->offset, exact + q->offset, tensor_count(&q->value));
    }
    equals("bank", fused + p->trained_floats, exact + p->trained_floats, n - p->trained_floats);
    mem_free(fused);
    mem_free(again);
    mem_free(exact);
    scene_close(&s);
}

/* Without AMX there is no bf16. */
static void small_agrees(void **state) {
    if (!isa_has_bf16()) skip();
    agrees("small,plane_resolution=32");
}
static void paper_agrees(void **state) {
    if (!isa_has_bf16()) skip();
    agrees("paper,plane_resolution=32,voxel_size_m=0.02,channel_max=32,encoder_width=8,style_width=32");
}

static void small_agrees_float(void **state) {
    agrees_float("small,plane_resolution=32");
}
static void paper_agrees_float(void **state) {
    agrees_float("paper,plane_resolution=32,voxel_size_m=0.02,channel_max=32,encoder_width=8,style_width=32");
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(small_agrees_float),
                                       cmocka_unit_test(paper_agrees_float), cmocka_unit_test(small_agrees),
                                       cmocka_unit_test(paper_agrees)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
