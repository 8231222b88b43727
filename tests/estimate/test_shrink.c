/* Tests of shrinking pictures against means taken by hand, for any number of threads. */
#include "estimate/shrink.h"
#include "support.h"

enum { W = 53, H = 37, C = 2 };

static double value(int x, int y, int k) {
    return 0.25 * x - 0.5 * y + k + (x * y % 7);
}

static void row(const void *user, int y, float *out) {
    for (int x = 0; x < W; x++)
        for (int k = 0; k < C; k++) *out++ = (float)value(x, y, k);
}

/* The mean over a target pixel's area, from W x H sample points; each border of a pixel lies between two of
 * them. */
static double mean(int width, int height, int x, int y, int k) {
    double sum = 0;
    for (int v = 0; v < H; v++)
        for (int u = 0; u < W; u++)
            sum += value((int)((x + (u + 0.5) / W) * W / width), (int)((y + (v + 0.5) / H) * H / height), k);
    return sum / (W * H);
}

static void means(void **state) {
    static const int size[][2] = {{W, H}, {53, 1}, {1, 37}, {20, 10}, {1, 1}};
    context *c = *state;
    for (size_t s = 0; s < COUNT_OF(size); s++) {
        sherf_image one = {size[s][0], size[s][1], C, NULL}, three = one;
        c->threads = 1;
        assert_ok(c, picture_shrink(c, row, NULL, W, H, &one));
        c->threads = 3;
        assert_ok(c, picture_shrink(c, row, NULL, W, H, &three));
        assert_memory_equal(one.data, three.data, (size_t)(one.width * one.height * C) * sizeof(float));
        for (int y = 0; y < one.height; y++)
            for (int x = 0; x < one.width; x++)
                for (int k = 0; k < C; k++)
                    assert_float_equal(one.data[(y * one.width + x) * C + k],
                                       mean(one.width, one.height, x, y, k), 1e-4);
        mem_free(one.data);
        mem_free(three.data);
    }
}

static int open_context(void **state) {
    *state = test_context();
    return 0;
}

static int close_context(void **state) {
    sherf_context_free(*state);
    return mem_live() != 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(means)};
    return cmocka_run_group_tests(tests, open_context, close_context);
}
