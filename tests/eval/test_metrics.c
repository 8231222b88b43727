/* Tests of PSNR and SSIM against their definitions, and of rectangles. */
#include <math.h>

#include "eval/metrics.h"
#include "support.h"

/* SSIM computed directly from its definition, window by window. */
static double ssim_by_definition(int width, int height, const float *a, const float *b, double range) {
    double total = 0, c1 = pow(0.01 * range, 2), c2 = pow(0.03 * range, 2);
    int count = 0;
    for (int k = 0; k < 3; k++)
        for (int y = 3; y < height - 3; y++)
            for (int x = 3; x < width - 3; x++, count++) {
                double ma = 0, mb = 0, va = 0, vb = 0, cab = 0;
                for (int j = -3; j <= 3; j++)
                    for (int i = -3; i <= 3; i++) {
                        ma += a[((y + j) * width + x + i) * 3 + k] / 49.0;
                        mb += b[((y + j) * width + x + i) * 3 + k] / 49.0;
                    }
                for (int j = -3; j <= 3; j++)
                    for (int i = -3; i <= 3; i++) {
                        double da = a[((y + j) * width + x + i) * 3 + k] - ma;
                        double db = b[((y + j) * width + x + i) * 3 + k] - mb;
                        va += da * da / 48, vb += db * db / 48, cab += da * db / 48;
                    }
                total += (2 * ma * mb + c1) * (2 * cab + c2) / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            }
    return total / count;
}

static void ssim_is_as_defined(void **state) {
    enum { W = 23, H = 17 };
    float a[W * H * 3], b[W * H * 3];
    test_centred("metrics.a", W * H * 3, 0.5, a);
    test_centred("metrics.b", W * H * 3, 0.2, b);
    for (int i = 0; i < W * H * 3; i++) a[i] += 0.5f, b[i] += a[i];
    context *c = test_context();
    double s;
    for (double range = 1; range <= 2; range++) {
        assert_ok(c, metric_ssim(c, W, H, 3, a, b, range, &s));
        assert_true(fabs(s - ssim_by_definition(W, H, a, b, range)) < 1e-9);
    }
    assert_ok(c, metric_ssim(c, W, H, 3, a, a, 2, &s));
    assert_true(fabs(s - 1) < 1e-12);
    assert_int_equal(metric_ssim(c, 6, 40, 3, a, b, 2, &s), SHERF_BAD_ARGUMENT);
    sherf_context_free(c);
}

static void psnr_looks_at_the_mask_only(void **state) {
    float a[4 * 3] = {0}, b[4 * 3] = {0};
    uint8_t mask[4] = {0, 1, 1, 0};
    b[0] = 9, b[11] = 9;      /* outside */
    b[3] = 0.1f, b[8] = 0.1f; /* two of six values differ by 0.1 */
    assert_true(fabs(metric_psnr(4, a, b, mask) - (-10 * log10(0.02 / 6))) < 1e-5);
    assert_true(metric_psnr(4, a, a, mask) == 100);
    assert_true(isnan(metric_psnr(4, a, b, (uint8_t[4]){0})));
}

static void bounds_and_crop(void **state) {
    uint8_t mask[5 * 4] = {0};
    mask[1 * 5 + 2] = mask[2 * 5 + 4] = 1;
    rectangle r;
    assert_true(mask_bounds(mask, 5, 4, &r));
    assert_int_equal(r.left, 2);
    assert_int_equal(r.top, 1);
    assert_int_equal(r.width, 3);
    assert_int_equal(r.height, 2);
    float picture[5 * 4 * 3], crop[3 * 2 * 3];
    for (int i = 0; i < 5 * 4 * 3; i++) picture[i] = (float)i;
    masked_crop(picture, mask, 5, r, crop);
    assert_true(crop[0] == picture[(5 + 2) * 3] && crop[17] == picture[(10 + 4) * 3 + 2]);
    assert_true(crop[3] == 0 && crop[9] == 0);
    assert_false(mask_bounds((uint8_t[20]){0}, 5, 4, &r));
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(ssim_is_as_defined),
                                       cmocka_unit_test(psnr_looks_at_the_mask_only),
                                       cmocka_unit_test(bounds_and_crop)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
