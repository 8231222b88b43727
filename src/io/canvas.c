/* Lines and letters, drawn pixel by pixel. */
#include "io/canvas.h"

#include <math.h>
#include <string.h>

sherf_status canvas_create(context *c, int width, int height, canvas *out) {
    *out = (canvas){width, height, mem_alloc(c, (size_t)width * (size_t)height, 3)};
    if (!out->rgb) return SHERF_NO_MEMORY;
    memset(out->rgb, 255, (size_t)width * (size_t)height * 3);
    return SHERF_OK;
}

void canvas_free(canvas *p) {
    mem_free(p->rgb);
    *p = (canvas){0};
}

void canvas_dot(canvas *p, int x, int y, color v) {
    if (x < 0 || y < 0 || x >= p->width || y >= p->height) return;
    uint8_t *to = p->rgb + 3 * ((size_t)y * (size_t)p->width + (size_t)x);
    to[0] = (uint8_t)(v >> 16), to[1] = (uint8_t)(v >> 8), to[2] = (uint8_t)v;
}

void canvas_segment(canvas *p, double x0, double y0, double x1, double y1, int thick, color v) {
    const int n = (int)fmax(fabs(x1 - x0), fabs(y1 - y0)) + 1;
    for (int i = 0; i <= n; i++) {
        const int x = (int)lround(x0 + (x1 - x0) * i / n), y = (int)lround(y0 + (y1 - y0) * i / n);
        for (int k = 0; k < thick * thick; k++) canvas_dot(p, x + k % thick, y + k / thick, v);
    }
}

/* Five rows of three pixels from the top. A row is an octal digit; its high bit is the left pixel. */
static int letter(char c) {
    static const int digits[] = {075557, 026227, 071747, 071717, 055711,
                                 074717, 074757, 071122, 075757, 075717};
    static const int letters[] = {025755, 065656, 034443, 065556, 074647, 074644, 034553, 055755, 072227,
                                  011152, 055655, 044447, 057755, 065555, 025552, 065644, 025573, 065655,
                                  034216, 072222, 055557, 055552, 055775, 055255, 055222, 071247};
    static const struct {
        char sign;
        int rows;
    } signs[] = {{'.', 000002}, {'-', 000700}, {'+', 002720}, {'(', 012221},
                 {')', 042224}, {':', 002020}, {'/', 011244}, {'%', 051245}};
    if (c >= '0' && c <= '9') return digits[c - '0'];
    if (c >= 'a' && c <= 'z') return letters[c - 'a'];
    if (c >= 'A' && c <= 'Z') return letters[c - 'A'];
    for (size_t i = 0; i < COUNT_OF(signs); i++)
        if (signs[i].sign == c) return signs[i].rows;
    return 0;
}

int canvas_text_width(const char *text) {
    return (int)strlen(text) * CANVAS_LETTER_WIDTH;
}

static void draw_letter(canvas *p, int x, int y, int rows, color v) {
    for (int i = 0; i < 15 * CANVAS_LETTER * CANVAS_LETTER; i++) {
        const int column = i % (3 * CANVAS_LETTER), row = i / (3 * CANVAS_LETTER);
        if (rows >> (14 - (row / CANVAS_LETTER * 3 + column / CANVAS_LETTER)) & 1)
            canvas_dot(p, x + column, y + row, v);
    }
}

void canvas_text(canvas *p, int x, int y, const char *text, color v) {
    for (; *text; text++, x += CANVAS_LETTER_WIDTH) draw_letter(p, x, y, letter(*text), v);
}

sherf_status canvas_write(context *c, const canvas *p, const char *path) {
    return png_write(c, path, p->width, p->height, 3, p->rgb);
}
