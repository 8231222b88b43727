/* sheet: an evaluation to look at. A row an observation: it, then pairs of prediction and truth. */
#ifndef SHERF_SHEET_H
#define SHERF_SHEET_H

#include "eval/metrics.h"

enum { SHEET_PAIRS = 4, SHEET_COLUMNS = 1 + 2 * SHEET_PAIRS, SHEET_CELL_PX = 128, SHEET_ROWS_MAX = 64 };

typedef struct {
    int rows, columns; /* columns: up to the last one with a picture */
    uint8_t *rgb;      /* rows * cell x SHEET_COLUMNS * cell x 3; NULL: no sheet */
} sheet;

sherf_status sheet_create(context *c, int rows, sheet *out); /* white */
void sheet_free(sheet *s);
/* The square round this part of a picture, scaled to the cell; black beyond the picture's edges. Rows past
 * the last are left out. */
sherf_status sheet_put(context *c, sheet *s, int row, int column, const sherf_image *image, rectangle part);
/* Only the columns that have pictures. */
sherf_status sheet_write(context *c, const sheet *s, const char *path);

#endif
