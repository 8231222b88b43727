/* Tests of a frame's losses against their definitions, and of leaving some out. */
#include <math.h>
#include <string.h>

#include "losses_of.h"
#include "support.h"

enum { W = 30, H = 26, N = W * H };

/* A frame, and a target whose box covers columns 4 to 23 and rows 2 to 21. */
typedef struct {
    float frame[5 * N], image[3 * N];
    uint8_t mask[N], unknown[N], at_box[N];
} scene;

static void make_scene(scene *s) {
    test_centred("losses.frame", 5 * N, 0.5, s->frame);
    test_centred("losses.image", 3 * N, 0.5, s->image);
    for (int i = 0; i < 5 * N; i++) s->frame[i] += 0.5f;
    for (int i = 0; i < N; i++) {
        int x = i % W, y = i / W;
        for (int k = 0; k < 3; k++) s->image[3 * i + k] += 0.5f;
        s->mask[i] = hypot(x - 14, y - 12) < 6;
        s->unknown[i] = s->mask[i] && hypot(x - 14, y - 12) > 5;
        s->at_box[i] = x >= 4 && x < 24 && y >= 2 && y < 22;
    }
}

static tape *made_up_tape(context *c) {
    tape *t = tape_create(c, (tape_options){.backend = &backend_ref_f32, .record = true, .training = true});
    assert_non_null(t);
    return t;
}

static void values_are_the_means(void **state) {
    static scene s;
    make_scene(&s);
    context *c = test_context();
    tape *t = made_up_tape(c);
    for (int with_unknown = 0; with_unknown < 2; with_unknown++) {
        tape_reset(t);
        tensor *frame = tape_input(t, s.frame, 2, (int64_t[]){N, 5}), *total;
        frame->needs_grad = true;
        loss_target g = {W, H, s.image, s.mask, with_unknown ? s.unknown : NULL, s.at_box};
        loss_values v;
        assert_ok(c, losses_of(t, NULL, frame, &g, &total, &v));
        double color = 0, mask = 0;
        int n = 0;
        for (int i = 0; i < N; i++) {
            if (!s.at_box[i] || (with_unknown && s.unknown[i])) continue;
            for (int k = 0; k < 3; k++) color += pow(s.frame[5 * i + k] - s.image[3 * i + k], 2) / 3;
            mask += pow(s.frame[5 * i + 3] - s.mask[i], 2);
            n++;
        }
        assert_true(fabs(v.color - color / n) < 1e-6 && fabs(v.mask - mask / n) < 1e-6);
        assert_true(v.ssim > -1 && v.ssim < 0.5 && isnan(v.lpips));
        assert_true(fabs(v.total - (100 * v.color + 10 * v.mask + 1 - v.ssim)) < 1e-4);
        assert_ok(c, tape_backward(t, total, 1));
        const float *d = tensor_f32(frame->grad);
        for (int i = 0; i < N; i++) {
            bool counts = s.at_box[i] && !(with_unknown && s.unknown[i]);
            for (int k = 0; k < 4; k++) assert_int_equal(d[5 * i + k] != 0, counts);
            assert_true(d[5 * i + 4] == 0); /* depth */
        }
    }
    tape_free(t);
    sherf_context_free(c);
}

/* Outside the mask the target has the background's colour. There a frame composited over that background has
 * no colour loss, and one over black has the square of the background. */
static void backgrounds_are_behind_the_person(void **state) {
    static scene s;
    make_scene(&s);
    context *c = test_context();
    tape *t = made_up_tape(c);
    const float grey = 0.6f;
    loss_target g = {W, H, s.image, s.mask, NULL, s.at_box, .background = grey};
    for (int over_black = 0; over_black < 2; over_black++) {
        int outside = 0, n = 0;
        for (int i = 0; i < N; i++) {
            for (int k = 0; k < 3; k++)
                s.frame[5 * i + k] = s.mask[i] ? s.image[3 * i + k] : over_black ? 0 : grey;
            n += s.at_box[i];
            outside += s.at_box[i] && !s.mask[i];
        }
        tape_reset(t);
        tensor *total;
        loss_values v;
        assert_ok(c, losses_of(t, NULL, tape_input(t, s.frame, 2, (int64_t[]){N, 5}), &g, &total, &v));
        const double expected = over_black ? (double)grey * grey * outside / n : 0;
        assert_true(outside > 100 && fabs(v.color - expected) < 1e-6);
        assert_true(over_black ? v.ssim < 0.9 : fabs(v.ssim - 1) < 1e-5);
    }
    tape_free(t);
    sherf_context_free(c);
}

static void lpips_adds_its_distance(void **state) {
    static scene s;
    make_scene(&s);
    context *c = test_context();
    tape *t = made_up_tape(c);
    lpips_network *l;
    assert_ok(c, lpips_create(c, &l));
    for (int i = 0; i < LPIPS_CONVOLUTIONS; i++)
        test_centred("losses.vgg", tensor_count(l->weight[i]), sqrt(6.0 / (9 * lpips_layers[i].in)),
                     tensor_f32(l->weight[i]));
    for (int i = 0; i < LPIPS_STAGES; i++)
        for (int64_t k = 0; k < tensor_count(l->head[i]); k++) tensor_f32(l->head[i])[k] = 0.01f;
    tensor *frame = tape_input(t, s.frame, 2, (int64_t[]){N, 5}), *total;
    loss_target g = {W, H, s.image, s.mask, NULL, s.at_box};
    loss_values v;
    assert_ok(c, losses_of(t, &(loss_networks){.lpips = l}, frame, &g, &total, &v));
    assert_true(v.lpips > 0);
    assert_true(fabs(v.total - (100 * v.color + 10 * v.mask + 1 - v.ssim + v.lpips)) < 1e-4);
    for (int i = 0; i < N; i++) memcpy(s.frame + 5 * i, s.image + 3 * i, 3 * sizeof(float));
    tape_reset(t);
    assert_ok(c, losses_of(t, &(loss_networks){.lpips = l}, tape_input(t, s.frame, 2, (int64_t[]){N, 5}), &g,
                           &total, &v));
    assert_true(v.lpips == 0 && v.color == 0 && fabs(v.ssim - 1) < 1e-5);
    lpips_free(l);
    tape_free(t);
    sherf_context_free(c);
}

static void resnet50_adds_its_distance(void **state) {
    static scene s;
    make_scene(&s);
    context *c = test_context();
    tape *t = made_up_tape(c);
    resnet50_network *r;
    assert_ok(c, resnet50_create(c, &r));
    for (int i = 0; i < RESNET50_CONVOLUTIONS; i++)
        test_centred("losses.resnet50", tensor_count(r->weight[i]),
                     sqrt(6.0 / (double)(tensor_count(r->weight[i]) / r->weight[i]->dim[0])),
                     tensor_f32(r->weight[i]));
    loss_target g = {W, H, s.image, s.mask, NULL, s.at_box};
    loss_values v;
    for (int own = 0; own < 2; own++) { /* its default weight, or a given one */
        tensor *frame = tape_input(t, s.frame, 2, (int64_t[]){N, 5}), *total;
        const loss_networks networks = {.resnet50 = r, .resnet50_weight = own ? 2 : 0};
        assert_ok(c, losses_of(t, &networks, frame, &g, &total, &v));
        double weight = own ? 2 : losses_resnet50_weight;
        assert_true(v.resnet50 > 0 && isnan(v.lpips));
        assert_true(fabs(v.total - (100 * v.color + 10 * v.mask + 1 - v.ssim + weight * v.resnet50)) < 1e-4);
        tape_reset(t);
    }
    resnet50_free(r);
    tape_free(t);
    sherf_context_free(c);
}

/* Without a term there is no gradient of it, and the total is that of the others. */
static void terms_are_left_out(void **state) {
    static scene s;
    make_scene(&s);
    context *c = test_context();
    tape *t = made_up_tape(c);
    loss_target g = {W, H, s.image, s.mask, NULL, s.at_box};
    for (unsigned without = 0; without < 8; without++) {
        tape_reset(t);
        tensor *frame = tape_input(t, s.frame, 2, (int64_t[]){N, 5}), *total;
        const loss_networks networks = {.without = without};
        loss_values v;
        if (without == (LOSS_COLOR | LOSS_MASK | LOSS_SSIM)) continue; /* no term would be left */
        frame->needs_grad = true;
        assert_ok(c, losses_of(t, &networks, frame, &g, &total, &v));
        const double parts[] = {100 * v.color, 10 * v.mask, 1 - v.ssim};
        double want = 0, opacity = 0, rgb = 0;
        for (int k = 0; k < 3; k++) want += without & 1u << k ? 0 : parts[k];
        assert_true(v.color > 0 && v.mask > 0 && !isnan(v.ssim) == !(without & LOSS_SSIM));
        if (!(fabs(v.total - want) < 1e-4)) fail_msg("without %u: %g, not %g", without, v.total, want);
        assert_ok(c, tape_backward(t, total, 1));
        for (int i = 0; i < N; i++) opacity += fabs((double)tensor_f32(frame->grad)[5 * i + 3]);
        for (int i = 0; i < N; i++) rgb += fabs((double)tensor_f32(frame->grad)[5 * i]);
        assert_true((opacity > 0) == !(without & LOSS_MASK));
        assert_true((rgb > 0) == ((without & (LOSS_COLOR | LOSS_SSIM)) != (LOSS_COLOR | LOSS_SSIM)));
    }
    unsigned bits;
    assert_ok(c, losses_parse(c, "perceptual,mask", &bits));
    assert_int_equal(bits, LOSS_MASK | LOSS_PERCEPTUAL);
    assert_ok(c, losses_parse(c, NULL, &bits));
    assert_int_equal(bits, 0);
    assert_fails(c, losses_parse(c, "mask,lpip", &bits), SHERF_BAD_ARGUMENT, "not 'lpip'");
    assert_fails(c, losses_parse(c, "mask,,ssim", &bits), SHERF_BAD_ARGUMENT, "not ''");
    assert_fails(c, losses_parse(c, "color,mask,perceptual,ssim", &bits), SHERF_BAD_ARGUMENT, "no loss");
    tape_free(t);
    sherf_context_free(c);
}

static void nothing_at_the_box(void **state) {
    static scene s;
    make_scene(&s);
    memset(s.at_box, 0, sizeof s.at_box);
    context *c = test_context();
    tape *t = made_up_tape(c);
    tensor *total;
    loss_target g = {W, H, s.image, s.mask, NULL, s.at_box};
    loss_values v;
    assert_ok(c, losses_of(t, NULL, tape_input(t, s.frame, 2, (int64_t[]){N, 5}), &g, &total, &v));
    assert_null(total);
    assert_true(v.total == 0);
    tape_free(t);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(values_are_the_means),    cmocka_unit_test(backgrounds_are_behind_the_person),
        cmocka_unit_test(lpips_adds_its_distance), cmocka_unit_test(resnet50_adds_its_distance),
        cmocka_unit_test(terms_are_left_out),      cmocka_unit_test(nothing_at_the_box)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
