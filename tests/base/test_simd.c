/* Tests of the elementary functions of base/simd.h: their errors are within the stated ones. */
#define LANES 4
#include <math.h>

#include "base/simd.h"
#include "support.h"

enum { STEPS = 1 << 18 };
typedef vf function(vf x);
typedef double definition(double x);

static vf sine(vf x) {
    vf s, c;
    sincos_lanes(x, &s, &c);
    return s;
}
static vf cosine(vf x) {
    vf s, c;
    sincos_lanes(x, &s, &c);
    return c;
}
static double gelu(double x) {
    return 0.5 * x * erfc(-x * M_SQRT1_2);
}
static double gelu_slope(double x) {
    return 0.5 * erfc(-x * M_SQRT1_2) + x * exp(-0.5 * x * x) * 0.5 * M_2_SQRTPI * M_SQRT1_2;
}

/* The largest error between two ends: of the value, or in units in the last place. */
static double worst(function *f, definition *is, double low, double high, bool last_places) {
    double largest = 0;
    for (int i = 0; i < STEPS; i += LANES) {
        vf x;
        for (int k = 0; k < LANES; k++) x[k] = (float)(low + (high - low) * (i + k) / STEPS);
        const vf y = f(x);
        for (int k = 0; k < LANES; k++) {
            const double right = is((double)x[k]), error = fabs((double)y[k] - right);
            const float size = fabsf((float)right);
            largest =
                fmax(largest, last_places ? error / (double)(nextafterf(size, INFINITY) - size) : error);
        }
    }
    return largest;
}

static void errors_are_as_stated(void **state) {
    assert_true(worst(exp_lanes, exp, -87, 88, true) < 1.2);
    assert_true(worst(sin_lanes, sin, -8000, 8000, false) < 1e-7);
    assert_true(worst(sine, sin, -40, 40, false) < 1e-7);
    assert_true(worst(cosine, cos, -8000, 8000, false) < 1e-7);
    assert_true(worst(gelu_lanes, gelu, -12, 12, false) < 3e-7);
    assert_true(worst(gelu_lanes, gelu, -6, -1, true) < 60);
    assert_true(worst(gelu_slope_lanes, gelu_slope, -12, 12, false) < 3e-7);
}

static void ends_and_not_a_number(void **state) {
    const vf x = {NAN, INFINITY, -INFINITY, 1e30f}, e = exp_lanes(x); /* compilers may fold these */
    assert_true(isnan(e[0]) && isfinite(e[1]) && e[2] > 0 && e[2] < 1e-37f);
    vf s, c;
    sincos_lanes(x, &s, &c);
    assert_true(isnan(s[0]) && isnan(c[0]));
    for (int k = 1; k < LANES; k++) assert_true(fabsf(s[k]) <= 1 && fabsf(c[k]) <= 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(errors_are_as_stated),
                                       cmocka_unit_test(ends_and_not_a_number)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
