/* Tests of the lattice of rays on which coarse frames look up the coarse field: the rays around a pixel,
 * their weights, and the values between them. */
#include <math.h>
#include <string.h>

#include "sampling/points_inside.h"
#include "support.h"

enum { WIDTH = 6, HEIGHT = 5, STRIDE = 2, COLUMNS = 3, ROWS = 3, RAYS = WIDTH * HEIGHT };

/* A picture whose rays begin and end at depths that are linear in row and column. */
typedef struct {
    float near[RAYS], far[RAYS];
    uint8_t at_box[RAYS];
    int32_t low[COLUMNS * ROWS], high[COLUMNS * ROWS], end[COLUMNS * ROWS];
    int64_t first[COLUMNS * ROWS + 1];
    ray_bundle rays;
    points_job job;
} picture;

static void make(picture *p) {
    memset(p, 0, sizeof *p);
    for (int n = 0; n < RAYS; n++) {
        p->near[n] = 2 + 0.1f * (float)(n % WIDTH) + 0.03f * (float)(n / WIDTH);
        p->far[n] = p->near[n] + 1;
        p->at_box[n] = 1;
    }
    for (int m = 0; m <= COLUMNS * ROWS; m++) p->first[m] = 10 * m;
    for (int m = 0; m < COLUMNS * ROWS; m++) p->low[m] = m, p->high[m] = m + 10, p->end[m] = 100 + m;
    p->rays.width = WIDTH, p->rays.height = HEIGHT;
    p->rays.near = p->near, p->rays.far = p->far, p->rays.at_box = p->at_box;
    p->job.rays = &p->rays;
    p->job.lattice = (ray_lattice){STRIDE, COLUMNS, ROWS, p->low, p->high, p->end, p->first, NULL};
}

/* The weighted mean of the rays' places is the pixel's; a ray of the lattice has itself alone. */
static void rays_surround_a_pixel(void **state) {
    picture p;
    make(&p);
    for (int n = 0; n < RAYS; n++) {
        const int row = n / WIDTH, column = n % WIDTH;
        ray_surrounding s;
        const bool between = ray_lattice_surround(&p.job, n, 0.01f, &s);
        assert_int_equal(between, column < WIDTH - 1); /* beyond the last column of the lattice */
        if (!between) continue;
        float weights = 0, x = 0, y = 0;
        for (int k = 0; k < s.count; k++) {
            const int m = s.ray[k].low;
            weights += s.weight[k];
            x += s.weight[k] * (float)(m % COLUMNS * STRIDE);
            y += s.weight[k] * (float)(m / COLUMNS * STRIDE);
            assert_int_equal(s.ray[k].at, p.first[m] - p.low[m]);
            assert_true(s.ray[k].high == p.high[m] && s.ray[k].end == p.end[m]);
        }
        assert_int_equal(s.count, (1 + row % STRIDE) * (1 + column % STRIDE));
        assert_true(fabsf(weights - 1) < 1e-6f && fabsf(x - (float)column) < 1e-5f);
        assert_true(fabsf(y - (float)row) < 1e-5f);
    }
}

/* Samples of one number are no neighbours where a ray begins or ends elsewhere, or misses the box. */
static void other_depths_are_no_neighbours(void **state) {
    enum { PIXEL = WIDTH + 1 };
    picture p;
    ray_surrounding s;
    for (int what = 0; what < 4; what++) {
        make(&p);
        if (what == 1) p.near[0] += 0.05f;
        if (what == 2) p.far[2 * WIDTH + 2] += 0.05f;
        if (what == 3) p.at_box[2] = 0;
        assert_int_equal(ray_lattice_surround(&p.job, PIXEL, 0.01f, &s), what == 0);
    }
    make(&p);
    p.job.lattice.stride = 1;
    assert_false(ray_lattice_surround(&p.job, PIXEL, 0.01f, &s));
}

static void values_are_interpolated(void **state) {
    static _Alignas(16) float value[6][4] = {{1, 0.2f, 0.4f, 0.6f}, {-8, 1, 1, 1}, {500, 0, 0, 0},
                                             {3, 0.6f, 0.8f, 1},    {4, 0, 1, 0},  {900, 1, 1, 1}};
    ray_lattice l = {.value = value};
    /* samples 5 to 7 of one ray, 4 to 6 of the other, which ends after sample 7 */
    const ray_surrounding s = {.count = 2,
                               .weight = {0.25f, 0.75f},
                               .ray = {{-5, 5, 8, 100}, {3 - 4, 4, 7, 8}},
                               .opaque = 200,
                               .differ = 20};
    _Alignas(16) float out[4];
    assert_true(ray_lattice_value(&l, &s, 5, out)); /* 1 and 4 */
    assert_true(fabsf(out[0] - 3.25f) < 1e-6f && fabsf(out[1] - 0.05f) < 1e-6f);
    assert_true(fabsf(out[2] - 0.85f) < 1e-6f && fabsf(out[3] - 0.15f) < 1e-6f);
    assert_true(ray_lattice_value(&l, &s, 4, out)); /* nothing, and 3 */
    assert_true(fabsf(out[0] - 2.25f) < 1e-6f);
    assert_false(ray_lattice_value(&l, &s, 6, out)); /* -8 and 900 */
    assert_false(ray_lattice_value(&l, &s, 7, out)); /* 500, and nothing */
    assert_false(ray_lattice_value(&l, &s, 8, out)); /* behind the end of one */
    value[1][0] = 300;
    assert_true(ray_lattice_value(&l, &s, 6, out)); /* 300 and 900, both opaque */
    assert_true(fabsf(out[0] - 750) < 1e-3f);
    value[1][0] = -8;
    assert_true(ray_lattice_value(&l, &s, 3, out) && out[0] == 0 && out[3] == 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(rays_surround_a_pixel),
                                       cmocka_unit_test(other_depths_are_no_neighbours),
                                       cmocka_unit_test(values_are_interpolated)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
