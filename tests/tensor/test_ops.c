/* Tests of every op: gradients of the reference kernels in double against central differences, every backend
 * against the reference, and that no op was forgotten. */
#include "cases.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "check.inc"

static double loss_of(tape *t, const op_case *k, tensor **in) {
    tape_reset(t);
    tensor *y = run_case(t, k, in);
    double sum = 0;
    for (int64_t i = 0; i < tensor_count(y); i++) sum += seed(i) * value(y, i);
    return sum;
}

/* Compares the gradient g of one input with central differences. */
static void check_input(tape *plain, const op_case *k, tensor **in, int i) {
    double *x = in[i]->data, *g = in[i]->grad->data, largest = 0, worst = 0;
    int64_t n = tensor_count(in[i]), at = 0;
    for (int64_t j = 0; j < n; j++) largest = fmax(largest, fabs(g[j]));
    for (int64_t j = 0; j < n; j++) {
        double old = x[j], h = 1e-5 * fmax(1, fabs(old));
        x[j] = old + h;
        double up = loss_of(plain, k, in);
        x[j] = old - h;
        double down = loss_of(plain, k, in);
        x[j] = old;
        double error = fabs((up - down) / (2 * h) - g[j]) / fmax(largest, 1e-3);
        if (error <= worst) continue;
        worst = error;
        at = j;
    }
    if (!(worst <= 1e-6))
        fail_msg("%s: gradient of input %d differs by %g at %lld (is %g)", k->name, i, worst, (long long)at,
                 g[at]);
}

static void check_gradient(context *c, const op_case *k) {
    tensor *in[OP_MAX_IN];
    inputs_make(c, k, T_F64, in);
    tape *t = tape_create(c, (tape_options){&backend_ref_f64, true, k->training, false});
    tape *plain = tape_create(c, (tape_options){&backend_ref_f64, false, k->training, false});
    assert_non_null(t);
    assert_non_null(plain);
    tensor *y = run_case(t, k, in);
    assert_true(y->needs_grad);
    seed_backward(t, y);
    for (int i = 0; i < k->inputs; i++)
        if (in[i] && in[i]->needs_grad) check_input(plain, k, in, i);
    tape_free(plain);
    tape_free(t);
    inputs_free(k, in);
}

static void gradients(void **state) {
    context *c = test_context();
    for (int i = 0; i < case_count(); i++)
        if (!case_at(i)->large && differentiable[case_at(i)->op]) check_gradient(c, case_at(i));
    sherf_context_free(c);
}

/* Fills the memory of the tape's next tensors with not-a-numbers. */
static void fill_memory(tape *t) {
    const size_t bytes = tape_peak(t);
    for (int i = 0; i < 2; i++) { /* the first call may take new blocks, which the reset merges */
        tape_reset(t);
        void *p = tape_alloc(t, bytes, 1);
        assert_non_null(p);
        memset(p, 0xff, bytes);
    }
    tape_reset(t);
}

/* Gradients written to fresh memory equal those added to cleared memory: kernels that write a fresh gradient
 * write all of it. */
static void check_fresh(context *c, const op_case *k, bool bf16) {
    tensor *in[OP_MAX_IN], *old[OP_MAX_IN] = {NULL};
    inputs_make(c, k, T_F32, in);
    tape *t = tape_create(c, (tape_options){&backend_cpu, true, k->training, bf16});
    assert_non_null(t);
    seed_backward(t, run_case(t, k, in));
    fill_memory(t);
    for (int i = 0; i < k->inputs; i++) {
        if (!in[i] || !in[i]->needs_grad) continue;
        old[i] = in[i]->grad;
        in[i]->grad = NULL;
    }
    seed_backward(t, run_case(t, k, in));
    for (int i = 0; i < k->inputs; i++) {
        if (!old[i]) continue;
        char what[32];
        snprintf(what, sizeof what, "fresh gradient %d", i);
        assert_non_null(in[i]->grad);
        compare(k, &backend_cpu, what, old[i], in[i]->grad, 0);
        in[i]->grad = old[i];
    }
    tape_free(t);
    inputs_free(k, in);
}

static void fresh_agree(void **state) {
    context *c = test_context();
    for (int i = 0; i < case_count(); i++)
        for (int bf16 = 0; bf16 < 1 + isa_has_bf16() && differentiable[case_at(i)->op]; bf16++)
            check_fresh(c, case_at(i), bf16);
    sherf_context_free(c);
}

/* A second pass adds to the gradients of the first. */
static void check_added(context *c, const op_case *k) {
    tensor *in[OP_MAX_IN], *twice[OP_MAX_IN] = {NULL};
    inputs_make(c, k, T_F32, in);
    tape *t = tape_create(c, (tape_options){&backend_cpu, true, k->training, false});
    assert_non_null(t);
    seed_backward(t, run_case(t, k, in));
    for (int i = 0; i < k->inputs; i++) {
        if (!in[i] || !in[i]->needs_grad) continue;
        twice[i] = tensor_create(c, T_F32, in[i]->rank, in[i]->dim);
        assert_non_null(twice[i]);
        for (int64_t j = 0; j < tensor_count(in[i]); j++)
            tensor_f32(twice[i])[j] = 2 * tensor_f32(in[i]->grad)[j];
    }
    tape_reset(t);
    seed_backward(t, run_case(t, k, in));
    for (int i = 0; i < k->inputs; i++) {
        if (!twice[i]) continue;
        char what[32];
        snprintf(what, sizeof what, "gradient %d, twice,", i);
        compare(k, &backend_cpu, what, twice[i], in[i]->grad, 2e-5);
        tensor_free(twice[i]);
    }
    tape_free(t);
    inputs_free(k, in);
}

static void gradients_add(void **state) {
    context *c = test_context();
    for (int i = 0; i < case_count(); i++)
        if (differentiable[case_at(i)->op]) check_added(c, case_at(i));
    sherf_context_free(c);
}

/* x + x, and x + a view of x: the first gradient is written, the second added. */
static void fresh_twice(void **state) {
    context *c = test_context();
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true});
    assert_non_null(t);
    for (int view = 0; view < 2; view++) {
        tape_reset(t);
        tensor *x = tape_input(t, (const float[]){1, 2, 3, 4}, 2, (int64_t[]){2, 2});
        assert_non_null(x);
        x->needs_grad = true;
        tensor *other =
            view ? tape_reshape(t, tape_reshape(t, x, 1, (int64_t[]){4}), 2, (int64_t[]){2, 2}) : x;
        tensor *y = op_add(t, other, x), *z = op_add(t, y, op_scale(t, y, 3));
        assert_non_null(z);
        for (int i = 0; i < 4; i++) tensor_f32(tape_grad(t, z))[i] = (float)i;
        assert_int_equal(tape_backward_seeded(t), SHERF_OK);
        for (int i = 0; i < 4; i++) assert_true(tensor_f32(x->grad)[i] == (float)(8 * i));
    }
    tape_free(t);
    sherf_context_free(c);
}

static void backends_agree(void **state) {
    context *c = test_context();
    for (int i = 0; i < case_count(); i++) {
        check_backend(c, case_at(i), &backend_ref_f32, false);
        check_backend(c, case_at(i), &backend_cpu, false);
    }
    sherf_context_free(c);
}

static void bf16_agrees(void **state) {
    skip_without_bf16();
    context *c = test_context();
    for (int i = 0; i < case_count(); i++) check_backend(c, case_at(i), &backend_cpu, true);
    sherf_context_free(c);
}

/* The spatial kernels at the levels that the tests above did not use. */
static void levels_agree(void **state) {
    context *c = test_context();
    for (int level = ISA_PLAIN; level <= ISA_AVX2 && level < (int)test_isa_highest(); level++) {
        if (!test_isa((isa_level)level)) continue;
        for (int i = 0; i < cases_spatial_count; i++)
            check_backend(c, &cases_spatial[i], &backend_cpu, false);
    }
    test_isa_restore();
    sherf_context_free(c);
}

static void run_with_threads(context *c, const op_case *k, bool bf16, int threads, tensor **in, tape **t,
                             tensor **y) {
    c->threads = threads;
    inputs_make(c, k, T_F32, in);
    *t = tape_create(c, (tape_options){&backend_cpu, differentiable[k->op], k->training, bf16});
    assert_non_null(*t);
    *y = run_case(*t, k, in);
    if (differentiable[k->op]) seed_backward(*t, *y);
}

/* Kernels give the same bits with any number of threads. */
static void threads_agree(void **state) {
    context *c = test_context();
    const int precisions = 1 + isa_has_bf16();
    for (int i = 0; i < precisions * case_count(); i++) {
        const op_case *k = case_at(i / precisions);
        const bool bf16 = i % precisions;
        tensor *one_in[OP_MAX_IN], *in[OP_MAX_IN], *one, *y;
        tape *one_tape, *t;
        run_with_threads(c, k, bf16, 1, one_in, &one_tape, &one);
        for (int threads = 2; threads <= 5; threads += 3) {
            run_with_threads(c, k, bf16, threads, in, &t, &y);
            if (memcmp(one->data, y->data, (size_t)tensor_count(y) * sizeof(float)))
                fail_msg("%s: %d threads give another value than one", k->name, threads);
            for (int j = 0; j < k->inputs; j++)
                if (in[j] && in[j]->needs_grad &&
                    memcmp(one_in[j]->grad->data, in[j]->grad->data,
                           (size_t)tensor_count(in[j]) * sizeof(float)))
                    fail_msg("%s: %d threads give another gradient %d than one", k->name, threads, j);
            tape_free(t);
            inputs_free(k, in);
        }
        tape_free(one_tape);
        inputs_free(k, one_in);
    }
    sherf_context_free(c);
}

static void nothing_forgotten(void **state) {
    for (int op = 0; op < OP_COUNT; op++) {
        bool found = false;
        for (int i = 0; i < case_count(); i++)
            if ((int)case_at(i)->op == op && (!differentiable[op] || !case_at(i)->large)) found = true;
        if (!found) fail_msg("no case for op %s", op_names[op]);
        if (!backend_ref_f32.forward[op] || !backend_ref_f64.forward[op])
            fail_msg("no reference kernel for %s", op_names[op]);
        if (!backend_cpu.forward[op]) fail_msg("no CPU kernel for %s", op_names[op]);
        if (differentiable[op] && (!backend_ref_f64.backward[op] || !backend_cpu.backward[op]))
            fail_msg("no gradient for %s", op_names[op]);
    }
}

static void errors_stick(void **state) {
    context *c = test_context();
    tape *t = tape_create(c, (tape_options){.backend = &backend_ref_f32});
    tensor *x = tape_zeros(t, T_F32, 2, (int64_t[]){2, 3}), *w = tape_zeros(t, T_F32, 2, (int64_t[]){4, 5});
    assert_null(op_linear(t, op_linear(t, x, w, NULL, 1, 1), w, NULL, 1, 1));
    assert_int_equal(tape_status(t), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "linear"));
    tape_reset(t);
    assert_int_equal(tape_status(t), SHERF_OK);
    tape_free(t);
    sherf_context_free(c);
}

/* The memory of dropped tensors is reused, but only if nothing is recorded. */
static void dropped_memory(void **state) {
    context *c = test_context();
    for (int record = 0; record < 2; record++) {
        tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = record});
        const int64_t small[] = {4, 16};
        static float constant[64];
        tensor *a = tape_zeros(t, T_F32, 2, small), *b = tape_zeros(t, T_F32, 2, small);
        tensor *kept = tape_zeros(t, T_F32, 2, small), *other = tape_constant(t, T_F32, 2, small, constant);
        void *first = b->data;
        tape_drop(t, NULL);
        tape_drop(t, other);
        assert_ptr_equal(other->data, constant);
        assert_non_null(tape_instead(t, tape_reshape(t, kept, 1, (int64_t[]){64}), kept)->data);
        tape_drop(t, tape_reshape(t, b, 1, (int64_t[]){64}));
        tape_drop(t, a);
        tensor *y = tape_zeros(t, T_F32, 2, small);
        assert_true((y->data == first) == !record);
        assert_true((a->data == NULL) == !record);
        tape_drop(t, y);
        tape_reset(t);
        assert_int_equal(tape_status(t), SHERF_OK);
        tape_free(t);
    }
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(gradients),         cmocka_unit_test(backends_agree),
                                       cmocka_unit_test(bf16_agrees),       cmocka_unit_test(levels_agree),
                                       cmocka_unit_test(threads_agree),     cmocka_unit_test(fresh_agree),
                                       cmocka_unit_test(gradients_add),     cmocka_unit_test(fresh_twice),
                                       cmocka_unit_test(nothing_forgotten), cmocka_unit_test(errors_stick),
                                       cmocka_unit_test(dropped_memory)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
