/* Tests of the perceptual distance against plain loops in double, with made-up weights. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "nn/resnet50.h"
#include "support.h"

enum { H = 18, W = 21, VALUES = H * W * 3 };

/* ---- the slow implementation: everything in double, without ops ---- */
typedef struct {
    int h, w, c;
    double *v;
} map;

static map map_make(int h, int w, int c) {
    return (map){h, w, c, calloc((size_t)h * (size_t)w * (size_t)c, sizeof(double))};
}

/* A convolution padded with side / 2 zeros. Frees x if `eat`. */
static map slow_convolution(const resnet50_network *n, int layer, map x, bool relu, bool eat) {
    const resnet50_layer *l = &resnet50_layers[layer];
    const float *weight = tensor_f32(n->weight[layer]), *bias = tensor_f32(n->bias[layer]);
    const int k = l->side, s = l->stride, pad = k / 2;
    assert_int_equal(x.c, l->in);
    map y = map_make((x.h + 2 * pad - k) / s + 1, (x.w + 2 * pad - k) / s + 1, l->out);
    for (int i = 0; i < y.h; i++)
        for (int j = 0; j < y.w; j++)
            for (int o = 0; o < y.c; o++) {
                double sum = bias[o];
                for (int r = 0; r < k; r++)
                    for (int q = 0; q < k; q++) {
                        int row = i * s + r - pad, column = j * s + q - pad;
                        if (row < 0 || row >= x.h || column < 0 || column >= x.w) continue;
                        for (int c = 0; c < x.c; c++)
                            sum +=
                                x.v[(row * x.w + column) * x.c + c] * weight[((o * x.c + c) * k + r) * k + q];
                    }
                y.v[(i * y.w + j) * y.c + o] = relu && sum < 0 ? 0 : sum;
            }
    if (eat) free(x.v);
    return y;
}

static map slow_pool(map x) {
    map y = map_make((x.h - 1) / 2 + 1, (x.w - 1) / 2 + 1, x.c);
    for (int i = 0; i < y.h; i++)
        for (int j = 0; j < y.w; j++)
            for (int c = 0; c < y.c; c++) {
                double max = 0; /* zero padding */
                for (int r = 2 * i - 1; r <= 2 * i + 1; r++)
                    for (int q = 2 * j - 1; q <= 2 * j + 1; q++)
                        if (r >= 0 && r < x.h && q >= 0 && q < x.w)
                            max = fmax(max, x.v[(r * x.w + q) * x.c + c]);
                y.v[(i * y.w + j) * y.c + c] = max;
            }
    return y;
}

static void slow_features(const resnet50_network *n, const double *picture, map out[3]) {
    static const double mean[3] = {123.68, 116.779, 103.939};
    static const int blocks[2] = {3, 4};
    map x = map_make(H, W, 3);
    for (int i = 0; i < VALUES; i++) x.v[i] = 255 * picture[i] - mean[i % 3];
    int layer = 1;
    out[0] = slow_convolution(n, 0, x, true, true);
    x = slow_pool(out[0]);
    for (int stage = 0; stage < 2; stage++) {
        for (int block = 0; block < blocks[stage]; block++) {
            map y = slow_convolution(n, layer, x, true, false);
            y = slow_convolution(n, layer + 1, y, true, true);
            y = slow_convolution(n, layer + 2, y, false, true);
            map shortcut = x;
            bool keep = stage && !block; /* the result of stage 2 goes to the caller */
            if (!block) {
                shortcut = slow_convolution(n, layer + 3, x, false, false);
                if (!keep) free(x.v);
            }
            for (int i = 0; i < y.h * y.w * y.c; i++) y.v[i] = fmax(y.v[i] + shortcut.v[i], 0);
            free(shortcut.v);
            x = y;
            layer += block ? 3 : 4;
        }
        out[stage + 1] = x;
    }
    assert_int_equal(layer, RESNET50_CONVOLUTIONS);
}

static double slow_distance(const resnet50_network *n, const double *a, const double *b) {
    map of_a[3], of_b[3];
    double total = 0;
    slow_features(n, a, of_a);
    slow_features(n, b, of_b);
    for (int s = 0; s < 3; s++) {
        int pixels = of_a[s].h * of_a[s].w, C = of_a[s].c;
        double sum = 0;
        for (int p = 0; p < pixels; p++) {
            const double *u = of_a[s].v + p * C, *v = of_b[s].v + p * C;
            double uu = 0, vv = 0;
            for (int c = 0; c < C; c++) uu += u[c] * u[c], vv += v[c] * v[c];
            for (int c = 0; c < C; c++) sum += pow(u[c] / (sqrt(uu) + 1e-10) - v[c] / (sqrt(vv) + 1e-10), 2);
        }
        total += sum / pixels;
        free(of_a[s].v);
        free(of_b[s].v);
    }
    return total;
}

/* ---- tests ---- */

static resnet50_network *made_up(context *c) {
    resnet50_network *n;
    assert_ok(c, resnet50_create(c, &n));
    for (int i = 0; i < RESNET50_CONVOLUTIONS; i++) {
        const resnet50_layer *l = &resnet50_layers[i];
        test_centred(l->name, tensor_count(n->weight[i]), sqrt(3.0 / (l->in * l->side * l->side)),
                     tensor_f32(n->weight[i]));
        test_centred("resnet50.bias", l->out, 0.1, tensor_f32(n->bias[i]));
    }
    return n;
}

static void pictures(float *a, float *b) {
    test_centred("resnet50.a", VALUES, 0.5, a);
    test_centred("resnet50.b", VALUES, 0.1, b);
    for (int i = 0; i < VALUES; i++) {
        a[i] += 0.5f;
        b[i] = 0.9f * a[i] + b[i];
    }
}

static void as_the_slow_one(void **state) {
    context *c = test_context();
    resnet50_network *n = made_up(c);
    static float a[VALUES], b[VALUES];
    static double exact_a[VALUES], exact_b[VALUES], step[VALUES];
    pictures(a, b);
    for (int i = 0; i < VALUES; i++) exact_a[i] = a[i], exact_b[i] = b[i];
    const double want = slow_distance(n, exact_a, exact_b);
    assert_true(want > 0.05 && want < 2);
    const backend *const backends[] = {&backend_ref_f32, &backend_cpu};
    for (size_t k = 0; k < COUNT_OF(backends); k++) {
        tape *t = tape_create(c, (tape_options){.backend = backends[k], .record = true});
        const int64_t shape[3] = {H, W, 3};
        tensor *x = tape_input(t, a, 3, shape);
        x->needs_grad = true;
        tensor *d = resnet50_distance(t, n, x, tape_input(t, b, 3, shape));
        assert_ok(c, tape_status(t));
        assert_true(fabs(*tensor_f32(d) - want) < 1e-5 * want);
        assert_ok(c, tape_backward(t, d, 1));
        /* along a random direction, by central differences of the slow implementation */
        const double h = 1e-6;
        double slope = 0;
        static float direction[VALUES];
        test_centred("resnet50.direction", VALUES, 1, direction);
        for (int i = 0; i < VALUES; i++) slope += (double)tensor_f32(x->grad)[i] * direction[i];
        for (int i = 0; i < VALUES; i++) step[i] = exact_a[i] + h * direction[i];
        double difference = slow_distance(n, step, exact_b);
        for (int i = 0; i < VALUES; i++) step[i] = exact_a[i] - h * direction[i];
        difference = (difference - slow_distance(n, step, exact_b)) / (2 * h);
        if (fabs(slope - difference) > 1e-3 * fabs(difference))
            fail_msg("%s: slope %.8g, by differences %.8g", backends[k]->name, slope, difference);
        tape_free(t);
    }
    resnet50_free(n);
    sherf_context_free(c);
}

static void bf16_is_near(void **state) {
    skip_without_bf16();
    context *c = test_context();
    resnet50_network *n = made_up(c);
    static float a[VALUES], b[VALUES];
    const int64_t shape[3] = {H, W, 3};
    double value[2];
    pictures(a, b);
    for (int k = 0; k < 2; k++) {
        tape *t = tape_create(c, (tape_options){.backend = &backend_cpu, .bf16 = k});
        tensor *d = resnet50_distance(t, n, tape_input(t, a, 3, shape), tape_input(t, b, 3, shape));
        assert_ok(c, tape_status(t));
        value[k] = *tensor_f32(d);
        tape_reset(t);
        d = resnet50_distance(t, n, tape_input(t, a, 3, shape), tape_input(t, a, 3, shape));
        assert_true(*tensor_f32(d) < 1e-12);
        tape_free(t);
    }
    assert_true(fabs(value[1] - value[0]) < 0.02 * value[0]);
    resnet50_free(n);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(as_the_slow_one), cmocka_unit_test(bf16_is_near)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
