/* canvas: a picture that lines and small letters are drawn on. */
#ifndef SHERF_CANVAS_H
#define SHERF_CANVAS_H

#include "io/image.h"

typedef struct {
    int width, height;
    uint8_t *rgb; /* height x width x 3; owned */
} canvas;
typedef uint32_t color; /* 0xRRGGBB */

sherf_status canvas_create(context *c, int width, int height, canvas *out); /* white */
void canvas_free(canvas *p);                                                /* fine on zeroes */
/* Parts outside the picture are clipped. A line is `thick` pixels wide. */
void canvas_dot(canvas *p, int x, int y, color v);
void canvas_segment(canvas *p, double x0, double y0, double x1, double y1, int thick, color v);

/* Letters of CANVAS_LETTER_WIDTH x CANVAS_LETTER_HEIGHT pixels: small letters, digits and . - + ( ) : / %;
 * others are blanks, capitals are drawn small. x, y: the upper left corner. */
enum { CANVAS_LETTER = 3, CANVAS_LETTER_WIDTH = 4 * CANVAS_LETTER, CANVAS_LETTER_HEIGHT = 5 * CANVAS_LETTER };
int canvas_text_width(const char *text);
void canvas_text(canvas *p, int x, int y, const char *text, color v);

sherf_status canvas_write(context *c, const canvas *p, const char *path); /* PNG */

#endif
