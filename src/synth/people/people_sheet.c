/* A contact sheet: one person in each row, with pictures spread over poses and views. */
#include <stdio.h>
#include <string.h>

#include "data/thuman_write.h"
#include "synth/people/people.h"

enum { COLUMNS = 10, ROWS_MAX = 64, CELL = 160 };

/* Shrinks by averaging squares of pixels; grows by repeating. */
static void put_cell(const image_u8 *in, uint8_t *sheet, int width, int x0, int y0) {
    for (int y = 0; y < CELL; y++)
        for (int x = 0; x < CELL; x++) {
            int ax = x * in->width / CELL, bx = (x + 1) * in->width / CELL, ay = y * in->height / CELL,
                by = (y + 1) * in->height / CELL;
            int sum[3] = {0}, n = 0;
            for (int v = ay; v < (by > ay ? by : ay + 1); v++)
                for (int u = ax; u < (bx > ax ? bx : ax + 1); u++, n++)
                    for (int k = 0; k < 3; k++)
                        sum[k] += in->data[3 * ((size_t)v * (size_t)in->width + (size_t)u) + (size_t)k];
            for (int k = 0; k < 3; k++)
                sheet[3 * ((size_t)(y0 + y) * (size_t)width + (size_t)(x0 + x)) + (size_t)k] =
                    (uint8_t)(sum[k] / n);
        }
}

sherf_status people_sheet(context *c, const char *folder, int people, const char *const *name, int poses,
                          int views, const char *png) {
    int rows = people < ROWS_MAX ? people : ROWS_MAX;
    int columns = (int64_t)poses * views < COLUMNS ? poses * views : COLUMNS; /* no repetition */
    int width = columns * CELL;
    if (!rows) return failure(c, SHERF_NO_FILE, "%s: nobody to show", folder);
    uint8_t *sheet = mem_zero(c, (size_t)width * (size_t)rows * CELL, 3);
    if (!sheet) return SHERF_NO_MEMORY;
    sherf_status status = SHERF_OK;
    for (int r = 0; r < rows && !status; r++) {
        char one[PATH_LENGTH], path[PATH_LENGTH];
        status = thuman_path(c, one, folder, name[(int64_t)r * people / rows]);
        for (int i = 0; i < columns && !status; i++) {
            /* the front first, then round the person */
            int view = (views / 2 + i * (views > COLUMNS ? views / COLUMNS : 1)) % views,
                pose = (int)((int64_t)i * poses / columns);
            image_u8 image = {0};
            status = thuman_picture_path(c, path, one, "", view, pose, ".png");
            if (!status) status = image_read(c, path, 3, &image);
            if (!status) put_cell(&image, sheet, width, i * CELL, r * CELL);
            mem_free(image.data);
        }
    }
    if (!status) status = png_write(c, png, width, rows * CELL, 3, sheet);
    mem_free(sheet);
    return status;
}
