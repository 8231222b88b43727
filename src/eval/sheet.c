/* An evaluation as one picture, a row an observation. */
#include "eval/sheet.h"

#include <string.h>

#include "data/data.h"

enum { WIDTH = SHEET_COLUMNS * SHEET_CELL_PX };

sherf_status sheet_create(context *c, int rows, sheet *out) {
    out->columns = 0;
    out->rows = rows < SHEET_ROWS_MAX ? rows : SHEET_ROWS_MAX;
    const size_t bytes = (size_t)out->rows * SHEET_CELL_PX * WIDTH * 3;
    out->rgb = mem_alloc(c, bytes, 1);
    if (!out->rgb) return SHERF_NO_MEMORY;
    memset(out->rgb, 255, bytes);
    return SHERF_OK;
}

void sheet_free(sheet *s) {
    mem_free(s->rgb);
    *s = (sheet){0};
}

sherf_status sheet_put(context *c, sheet *s, int row, int column, const sherf_image *image, rectangle part) {
    const int side = part.width > part.height ? part.width : part.height;
    const int left = part.left - (side - part.width) / 2, top = part.top - (side - part.height) / 2;
    const int x0 = left > 0 ? left : 0, x1 = left + side < image->width ? left + side : image->width;
    if (row >= s->rows || side < 1 || x1 <= x0) return SHERF_OK;
    sherf_image cell = {side, side, 3, mem_zero(c, (size_t)side * (size_t)side, 3 * sizeof(float))};
    if (!cell.data) return SHERF_NO_MEMORY;
    for (int y = top > 0 ? 0 : -top; y < side && top + y < image->height; y++)
        memcpy(cell.data + 3 * ((size_t)y * (size_t)side + (size_t)(x0 - left)),
               image->data + 3 * ((size_t)(top + y) * (size_t)image->width + (size_t)x0),
               3 * (size_t)(x1 - x0) * sizeof(float));
    if (column >= s->columns) s->columns = column + 1;
    sherf_status status = image_resize_area(c, &cell, SHEET_CELL_PX, SHEET_CELL_PX);
    for (int y = 0; y < SHEET_CELL_PX && status == SHERF_OK; y++) {
        uint8_t *to =
            s->rgb + 3 * ((size_t)(row * SHEET_CELL_PX + y) * WIDTH + (size_t)(column * SHEET_CELL_PX));
        for (int i = 0; i < 3 * SHEET_CELL_PX; i++)
            to[i] = float_to_u8(cell.data[3 * (size_t)y * SHEET_CELL_PX + (size_t)i]);
    }
    mem_free(cell.data);
    return status;
}

sherf_status sheet_write(context *c, const sheet *s, const char *path) {
    const size_t width = (size_t)(s->columns ? s->columns : 1) * SHEET_CELL_PX;
    const size_t height = (size_t)s->rows * SHEET_CELL_PX;
    uint8_t *rgb = mem_alloc(c, height * width, 3);
    if (!rgb) return SHERF_NO_MEMORY;
    for (size_t y = 0; y < height; y++) memcpy(rgb + 3 * y * width, s->rgb + 3 * y * WIDTH, 3 * width);
    const sherf_status status = png_write(c, path, (int)width, (int)height, 3, rgb);
    mem_free(rgb);
    return status;
}
