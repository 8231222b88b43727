/* Tests of single values of the spatial ops, computed elsewhere or by hand, and of their behaviour at edges,
 * in every float32 backend. */
#include "support.h"

#include <math.h>
#include <string.h>

#include "tensor/tensor.h"

static const backend *const backends[] = {&backend_ref_f32, &backend_cpu};

#define INPUT(t, values, ...)                                                                                \
    tape_input(t, values, (int)COUNT_OF(((int64_t[]){__VA_ARGS__})), (const int64_t[]){__VA_ARGS__})
#define INPUT_I32(t, values, ...)                                                                            \
    tape_input_i32(t, values, (int)COUNT_OF(((int64_t[]){__VA_ARGS__})), (const int64_t[]){__VA_ARGS__})

static void near_to(const char *what, double got, double want, double tolerance) {
    if (!(fabs(got - want) <= tolerance)) fail_msg("%s is %.9g, not %.9g", what, got, want);
}

typedef void (*body)(tape *t);
static void each_backend(body f) {
    context *c = test_context();
    for (size_t i = 0; i < COUNT_OF(backends); i++) {
        tape *t = tape_create(c, (tape_options){.backend = backends[i], .record = true});
        assert_non_null(t);
        f(t);
        if (tape_status(t) != SHERF_OK) fail_msg("%s", c->message);
        tape_free(t);
    }
    sherf_context_free(c);
}

/* Two rays of six samples, white background: samples 1, 3 and 5 kept, then 1 and 3. */
static void composite_values(tape *t) {
    const float sigma[] = {3, 0.7f, 2, 3, 0.7f}, range[] = {2, 2, 2, 3, 3, 3}, one[] = {1.25f, 1.25f, 1.25f};
    const float rgb[] = {.2f, .4f, .6f, .9f, .1f, .3f, .5f, .6f, .7f, .2f, .4f, .6f, .9f, .1f, .3f};
    const int32_t first[] = {0, 3, 5, 5}, sample[] = {1, 3, 5, 1, 3};
    const float want[] = {.372044019f, .456555744f, .616902602f, 1,           2.54755919f,
                          .570309729f, .615168311f, .735862027f, .603468581f, 2.25026622f,
                          1,           1,           1,           0,           9};
    tensor *y = op_composite(t, INPUT(t, sigma, 5, 1), INPUT(t, rgb, 5, 3), INPUT_I32(t, first, 4),
                             INPUT_I32(t, sample, 5), INPUT(t, range, 3), INPUT(t, range + 3, 3),
                             INPUT(t, one, 3), NULL, (composite_attr){6, 1, 0.5f, 9});
    assert_non_null(y);
    for (int i = 0; i < 15; i++) near_to("composite", tensor_f32(y)[i], want[i], 3e-6);
}
static void test_composite(void **state) {
    each_backend(composite_values);
}

/* Explicit depths: those of even samples give the same frame, except for the last interval, which is given.
 */
static void composite_uneven(tape *t) {
    const float sigma[] = {3, 0.7f, 2, 0.7f}, near = 2, far = 3, length = 1.25f;
    const float rgb[] = {.2f, .4f, .6f, .9f, .1f, .3f, .5f, .6f, .7f, .2f, .4f, .6f};
    const float at[] = {2.2f, .2f, 2.6f, .2f, 2.8f, .2f, 2.9f, 0.1f};
    const int32_t first[] = {0, 4}, sample[] = {1, 3, 4, 0};
    const composite_attr attr = {6, 0.5f, 2, 3};
    double T = 1, want[5] = {0};
    for (int i = 0; i < 4; i++) {
        const double alpha = 1 - exp(-(double)sigma[i] * at[2 * i + 1] * length), w = T * alpha;
        for (int k = 0; k < 3; k++) want[k] += w * rgb[3 * i + k];
        want[3] += w;
        want[4] += w * at[2 * i];
        T *= 1 - alpha;
    }
    for (int k = 0; k < 3; k++) want[k] += T * 0.5;
    want[4] /= want[3];
    tensor *y = op_composite(t, INPUT(t, sigma, 4, 1), INPUT(t, rgb, 4, 3), INPUT_I32(t, first, 2),
                             INPUT_I32(t, sample, 4), INPUT(t, &near, 1), INPUT(t, &far, 1),
                             INPUT(t, &length, 1), INPUT(t, at, 4, 2), attr);
    assert_non_null(y);
    for (int i = 0; i < 5; i++) near_to("uneven composite", tensor_f32(y)[i], want[i], 1e-6);
    assert_null(op_composite(t, INPUT(t, sigma, 4, 1), INPUT(t, rgb, 4, 3), INPUT_I32(t, first, 2),
                             INPUT_I32(t, sample, 4), INPUT(t, &near, 1), INPUT(t, &far, 1),
                             INPUT(t, &length, 1), INPUT(t, at, 8, 1), attr));
    assert_int_equal(tape_status(t), SHERF_BAD_ARGUMENT);
    tape_reset(t);
}
static void test_uneven(void **state) {
    each_backend(composite_uneven);
}

/* Nothing passes the first sample (alpha is exactly 1): gradients are finite, and 0 behind it. */
static void opaque_gradient(tape *t) {
    const float sigma[] = {1e6f, 5, 1e6f}, rgb[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, near = 2, far = 3,
                length = 1;
    const int32_t first[] = {0, 3}, sample[] = {0, 1, 5};
    tensor *s = INPUT(t, sigma, 3, 1), *c = INPUT(t, rgb, 3, 3);
    s->needs_grad = c->needs_grad = true;
    tensor *y = op_composite(t, s, c, INPUT_I32(t, first, 2), INPUT_I32(t, sample, 3), INPUT(t, &near, 1),
                             INPUT(t, &far, 1), INPUT(t, &length, 1), NULL, (composite_attr){6, 0, 2, 3});
    assert_non_null(y);
    for (int i = 0; i < 5; i++) tensor_f32(tape_grad(t, y))[i] = 1;
    assert_int_equal(tape_backward_seeded(t), SHERF_OK);
    for (int i = 0; i < 3; i++) {
        near_to("dsigma", tensor_f32(s->grad)[i], 0, 1e-9);
        for (int k = 0; k < 3; k++) near_to("drgb", tensor_f32(c->grad)[3 * i + k], i == 0, 1e-9);
    }
}
static void test_opaque_gradient(void **state) {
    each_backend(opaque_gradient);
}

static void test_images(float x[714], float y[714]) {
    for (int i = 0; i < 714; i++) {
        x[i] = (float)(0.5 + 0.4 * sin(0.7 * i));
        y[i] = (float)(0.5 + 0.4 * sin(0.7 * i + 0.3 * (i % 5)));
    }
}

/* 14 x 17 x 3; values of an independent implementation in double. */
static void ssim_value(tape *t) {
    float a[714], b[714];
    test_images(a, b);
    tensor *x = INPUT(t, a, 14, 17, 3), *y = INPUT(t, b, 14, 17, 3);
    x->needs_grad = true;
    tensor *s = op_ssim(t, x, y);
    assert_non_null(s);
    near_to("ssim", tensor_f32(s)[0], 0.76722214067, 2e-6);
    assert_int_equal(tape_backward(t, s, 1), SHERF_OK);
    near_to("dssim", tensor_f32(x->grad)[(7 * 17 + 8) * 3 + 1], -0.023077694563, 1e-6);
    near_to("ssim of the same", tensor_f32(op_ssim(t, x, x))[0], 1, 1e-6);
}
static void test_ssim(void **state) {
    each_backend(ssim_value);
}

static void distance_value(tape *t) {
    float a[714], b[714];
    const float head[] = {0.5f, 1, 2};
    test_images(a, b);
    tensor *x = INPUT(t, a, 14, 17, 3), *y = INPUT(t, b, 14, 17, 3);
    x->needs_grad = true;
    tensor *s = op_feature_distance(t, x, y, INPUT(t, head, 3));
    assert_non_null(s);
    near_to("feature_distance", tensor_f32(s)[0], 0.103123785816, 3e-7);
    assert_int_equal(tape_backward(t, s, 1), SHERF_OK);
    near_to("its gradient", tensor_f32(x->grad)[(7 * 17 + 8) * 3 + 1], 0.001756045153, 1e-8);
}
static void test_distance(void **state) {
    each_backend(distance_value);
}

/* Pixels without any feature: compared with features, the distance is their share and the gradient 0;
 * compared with none, both are 0. */
static void distance_zero(tape *t) {
    const float a[6] = {0}, b[6] = {3, 0, 4, 0, 0, 0};
    tensor *x = INPUT(t, a, 1, 2, 3), *y = INPUT(t, b, 1, 2, 3);
    x->needs_grad = true;
    tensor *s = op_feature_distance(t, x, y, NULL);
    assert_non_null(s);
    near_to("feature_distance", tensor_f32(s)[0], 0.5, 1e-6);
    assert_int_equal(tape_backward(t, s, 1), SHERF_OK);
    for (int i = 0; i < 6; i++) near_to("its gradient", tensor_f32(x->grad)[i], 0, 0);
}
static void test_distance_zero(void **state) {
    each_backend(distance_zero);
}

/* Positions that are outside, not a number or infinite read zero and scatter nothing; inside, weights are
 * bilinear. */
static void sampling_edges(tape *t) {
    const float map[] = {1, 2, 4, 8}, x[] = {1, 10};
    const float at[] = {0.25f, 0.5f,  NAN, 0, INFINITY, 0,    0, -INFINITY, -1,
                        0,     1e20f, 0,   1, 1,        1.5f, 0, -0.25f,    1};
    const float want[] = {0.5f * 1.25f + 0.5f * 5, 0, 0, 0, 0, 0, 8, 1, 3};
    tensor *m = INPUT(t, map, 2, 2, 1);
    m->needs_grad = true;
    tensor *y = op_sample_bilinear(t, m, INPUT(t, at, 9, 2));
    assert_non_null(y);
    for (int i = 0; i < 9; i++) near_to("sample_bilinear", tensor_f32(y)[i], want[i], 1e-6);
    for (int i = 0; i < 9; i++) tensor_f32(tape_grad(t, y))[i] = 1;
    assert_int_equal(tape_backward_seeded(t), SHERF_OK);
    const float total[] = {0.375f, 0.125f + 0.5f, 0.375f + 0.75f, 0.125f + 1};
    for (int i = 0; i < 4; i++) near_to("dmap", tensor_f32(m->grad)[i], total[i], 1e-6);

    const int32_t grid[] = {0, -1, 1, -1}; /* z 1, y 2, x 2 */
    const float in[] = {0, 0, 0, 0, 0.5f, 0, 0.5f, 0.5f, 0, 0, 0, -0.5f, NAN, 0, 0, 0, 1e20f, 0, 0, 1, 0.75f};
    const float values[] = {1, 5.5f, 2.75f, 0.5f, 0, 0, 2.5f};
    y = op_sample_trilinear(t, INPUT(t, x, 2, 1), INPUT_I32(t, grid, 1, 2, 2), INPUT(t, in, 7, 3));
    assert_non_null(y);
    for (int i = 0; i < 7; i++) near_to("sample_trilinear", tensor_f32(y)[i], values[i], 1e-6);
}
static void test_sampling_edges(void **state) {
    each_backend(sampling_edges);
}

/* The order of the encoding's values, and arguments too large for the fast sine. */
static void encode_values(tape *t) {
    const float x[] = {0.5f, -1, 30000, 2};
    tensor *y = op_positional_encode(t, INPUT(t, x, 2, 2), 2, 9);
    assert_non_null(y);
    const double want[] = {0.5, -1, sin(.5), sin(-1), cos(.5), cos(-1), sin(1), sin(-2), cos(1)};
    for (int i = 0; i < 9; i++) near_to("positional_encode", tensor_f32(y)[i], want[i], 3e-7);
    near_to("a large sine", tensor_f32(y)[11], sin(30000), 1e-5);
    y = op_positional_encode(t, INPUT(t, x, 1, 2), 2, 9);
    for (int i = 0; i < 9; i++) near_to("positional_encode", tensor_f32(y)[i], want[i], 3e-7);
}
static void test_encode(void **state) {
    each_backend(encode_values);
}

/* Far arguments stay finite, and not-a-number stays not-a-number. */
static void activations(tape *t) {
    const float x[] = {-1000, -20, -0.0f, 20, 1000, NAN, -INFINITY, INFINITY};
    const double gelu[] = {0, 0, 0, 20, 1000}, sigmoid[] = {0, 0, 0.5, 1, 1},
                 softplus[] = {0, 2e-9, 0.693147181, 20, 1000};
    tensor *g = op_gelu(t, INPUT(t, x, 8)), *s = op_sigmoid(t, INPUT(t, x, 8), 1, 0),
           *p = op_softplus(t, INPUT(t, x, 8), 0);
    assert_non_null(g);
    assert_non_null(s);
    assert_non_null(p);
    for (int i = 0; i < 5; i++) {
        near_to("gelu", tensor_f32(g)[i], gelu[i], 1e-6);
        near_to("sigmoid", tensor_f32(s)[i], sigmoid[i], 1e-8);
        near_to("softplus", tensor_f32(p)[i], softplus[i], 1e-7);
    }
    assert_true(isnan(tensor_f32(g)[5]) && isnan(tensor_f32(s)[5]) && isnan(tensor_f32(p)[5]));
    near_to("sigmoid", tensor_f32(s)[6], 0, 1e-8);
    near_to("sigmoid", tensor_f32(s)[7], 1, 0);
}
static void test_activations(void **state) {
    each_backend(activations);
}

/* A rule that reads a row twice in one tap is not a convolution: the CPU's gradient refuses it. */
static void test_rule_twice(void **state) {
    context *c = test_context();
    tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .record = true});
    int32_t rule[54];
    memset(rule, 0xff, sizeof rule);
    rule[5] = rule[27 + 5] = 1;
    tensor *x = tape_zeros(t, T_F32, 2, (int64_t[]){2, 3});
    x->needs_grad = true;
    tensor *w = tape_zeros(t, T_F32, 5, (int64_t[]){4, 3, 3, 3, 3});
    tensor *y = op_sparse_conv(t, x, w, INPUT_I32(t, rule, 2, 27));
    assert_non_null(y);
    assert_non_null(tape_grad(t, y));
    assert_int_equal(tape_backward_seeded(t), SHERF_BAD_ARGUMENT);
    assert_non_null(strstr(c->message, "sparse_conv"));
    tape_free(t);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_composite),       cmocka_unit_test(test_uneven),
        cmocka_unit_test(test_opaque_gradient), cmocka_unit_test(test_ssim),
        cmocka_unit_test(test_distance),        cmocka_unit_test(test_distance_zero),
        cmocka_unit_test(test_sampling_edges),  cmocka_unit_test(test_encode),
        cmocka_unit_test(test_activations),     cmocka_unit_test(test_rule_twice),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
