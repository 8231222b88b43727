/* Tests of an evaluation's sheet: where pictures are placed, and what does not fit. */
#include "support.h"

#include <stdlib.h>

#include "eval/sheet.h"
#include "io/image.h"

static const uint8_t *at(const sheet *s, int row, int column, int x, int y) {
    const int width = SHEET_COLUMNS * SHEET_CELL_PX;
    return s->rgb + 3 * ((row * SHEET_CELL_PX + y) * width + column * SHEET_CELL_PX + x);
}

static void cells_hold_their_part(void **state) {
    enum { W = 40, H = 20 };
    context *c = test_context();
    sheet s;
    float data[W * H * 3];
    const sherf_image image = {W, H, 3, data};
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            float *p = data + 3 * (y * W + x);
            p[0] = x < 30 ? 1 : 0, p[1] = y < 10 ? 0.5f : 0, p[2] = 0.2f;
        }
    assert_ok(c, sheet_create(c, 2, &s));
    /* 20 x 4 pixels: the square extends from row -2 to row 18 */
    assert_ok(c, sheet_put(c, &s, 1, 3, &image, (rectangle){15, 6, 20, 4}));
    assert_int_equal(at(&s, 0, 3, 64, 64)[0], 255);
    assert_int_equal(at(&s, 1, 2, 127, 64)[0], 255);
    assert_int_equal(at(&s, 1, 3, 2, 2)[2], 0);                              /* beyond the picture's edge */
    assert_int_equal(at(&s, 1, 3, 2, 40)[2], 51);                            /* inside it */
    assert_int_equal(at(&s, 1, 3, 60, 40)[0], 255);                          /* x = 24 */
    assert_int_equal(at(&s, 1, 3, 120, 40)[0], 0);                           /* x = 33 */
    assert_int_equal(at(&s, 1, 3, 60, 60)[1], 128);                          /* y = 7 */
    assert_int_equal(at(&s, 1, 3, 60, 120)[1], 0);                           /* y = 16 */
    assert_ok(c, sheet_put(c, &s, 2, 0, &image, (rectangle){0, 0, W, H}));   /* no such row */
    assert_ok(c, sheet_put(c, &s, 0, 0, &image, (rectangle){90, 90, 5, 5})); /* outside the picture */
    assert_int_equal(at(&s, 0, 0, 64, 64)[1], 255);
    assert_ok(c, sheet_write(c, &s, test_path("sheet.png")));
    int width, height, channels;
    assert_ok(c, image_size(c, test_path("sheet.png"), &width, &height, &channels));
    assert_int_equal(width, 4 * SHEET_CELL_PX); /* no columns after the last one with a picture */
    assert_int_equal(height, 2 * SHEET_CELL_PX);
    image_u8 read = {0};
    assert_ok(c, image_read(c, test_path("sheet.png"), 3, &read));
    for (int y = 0; y < height; y++)
        assert_memory_equal(read.data + 3 * y * width, at(&s, 0, 0, 0, y), 3 * (size_t)width);
    mem_free(read.data);
    sheet_free(&s);
    sherf_context_free(c);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(cells_hold_their_part)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
