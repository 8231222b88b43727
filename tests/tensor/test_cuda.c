/* Tests of the CUDA backend against the reference in double, on the cases of test_ops.c: with kernels
 * emulated on the host (support/cuda) if there was a C++ compiler, and on a GPU if the build and the machine
 * have one. */
#include "cases.h"

#include "check.inc"

#include "base/device.h"

#ifdef HAVE_CUDA_EMULATED
extern const backend backend_emulated;
extern int cuda_emulated_order;
#else
static int cuda_emulated_order;
#endif

static const backend *backends[2];
static int backend_count;

static void backends_agree(void **state) {
    context *c = test_context();
    for (int b = 0; b < backend_count; b++)
        for (int i = 0; i < case_count(); i++)
            for (int bf16 = 0; bf16 < 2; bf16++) check_backend(c, case_at(i), backends[b], bf16);
    sherf_context_free(c);
}

static void nothing_forgotten(void **state) {
    for (int b = 0; b < backend_count; b++)
        for (int op = 0; op < OP_COUNT; op++)
            if (!backends[b]->forward[op] || (differentiable[op] && !backends[b]->backward[op]))
                fail_msg("%s: no kernel or no gradient for %s", backends[b]->name, op_names[op]);
}

/* Value and gradients. Emulated threads and blocks run in one of two orders. */
static void run_ordered(context *c, const op_case *k, const backend *b, int order, tensor **in,
                        tensor **value) {
    tensor *there[OP_MAX_IN];
    cuda_emulated_order = order;
    inputs_make(c, k, T_F32, in);
    tape *t = tape_create(c, (tape_options){b, differentiable[k->op], k->training, false});
    assert_non_null(t);
    inputs_upload(t, k, in, there);
    tensor *y = run_case(t, k, there);
    if (differentiable[k->op]) seed_backward(t, y);
    *value = tensor_create(c, y->type, y->rank, y->dim);
    assert_non_null(*value);
    assert_ok(c, tensor_download(c, y, (*value)->data));
    inputs_download(c, k, there, in);
    tape_free(t);
    cuda_emulated_order = 0;
}

static void check_order(context *c, const op_case *k, const backend *b) {
    tensor *in[2][OP_MAX_IN], *value[2];
    for (int order = 0; order < 2; order++) run_ordered(c, k, b, order, in[order], &value[order]);
    compare(k, b, "the value, another time,", value[0], value[1], 0);
    for (int j = 0; j < k->inputs; j++)
        if (in[0][j] && in[0][j]->grad)
            compare(k, b, "a gradient, another time,", in[0][j]->grad, in[1][j]->grad, 0);
    for (int order = 0; order < 2; order++) {
        inputs_free(k, in[order]);
        tensor_free(value[order]);
    }
}

/* The bits are the same again, in whatever order threads and blocks run. */
static void deterministic(void **state) {
    context *c = test_context();
    for (int b = 0; b < backend_count; b++)
        for (int i = 0; i < case_count(); i++)
            if (!case_at(i)->large || i % 3 == 0)
                check_order(c, case_at(i), backends[b]); /* some large ones */
    sherf_context_free(c);
}

/* A tensor in the host's memory is refused with its name, and so is an op without a kernel. */
static void refused(void **state) {
    context *c = test_context();
    tape *t = tape_create(c, (tape_options){.backend = backends[0]});
    assert_non_null(t);
    tensor *here = tensor_create(c, T_F32, 2, (int64_t[]){2, 3});
    assert_non_null(here);
    assert_null(op_scale(t, here, 2));
    assert_int_equal(tape_status(t), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "scale: input 0 [2, 3] lies in the host's memory"));
    tensor_free(here);
    tape_free(t);
    sherf_context_free(c);
}

/* A tape's use of the device's memory apart from ops. */
static void tape_agrees(void **state) {
    context *c = test_context();
    tape *t = tape_create(c, (tape_options){.backend = backends[0], .record = true});
    assert_non_null(t);
    for (int round = 0; round < 2; round++) {
        tape_reset(t);
        tensor *x = tape_input(t, (const float[]){3}, 1, (int64_t[]){1});
        assert_non_null(x);
        x->needs_grad = true;
        tensor *y = tape_reshape(t, op_add(t, op_scale(t, x, 2), x), 2, (int64_t[]){1, 1});
        assert_true(tape_value(t, y) == 9);
        assert_ok(c, tape_backward(t, y, 0.5));
        assert_true(tape_value(t, x->grad) == 1.5);
        tensor *z = tape_zeros(t, T_F32, 2, (int64_t[]){3, 1});
        assert_non_null(z);
        assert_ok(c, tensor_copy_rows(c, z, 1, x, 0, 1));
        float got[3];
        assert_ok(c, tensor_download(c, z, got));
        assert_true(got[0] == 0 && got[1] == 3 && got[2] == 0);
    }
    tape_free(t);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(nothing_forgotten), cmocka_unit_test(backends_agree),
                                       cmocka_unit_test(deterministic), cmocka_unit_test(refused),
                                       cmocka_unit_test(tape_agrees)};
    char line[128];
    const bool gpu = device_gpu_present(line, sizeof line);
    printf("%s: %s\n", gpu ? "on a GPU" : "on no GPU", line);
#ifdef SHERF_HAVE_CUDA
    if (gpu) backends[backend_count++] = &backend_cuda;
#endif
#ifdef HAVE_CUDA_EMULATED
    backends[backend_count++] = &backend_emulated;
#else
    puts("the emulated kernels are skipped: there was no C++ compiler");
#endif
    return backend_count ? cmocka_run_group_tests(tests, NULL, NULL) : 77;
}
