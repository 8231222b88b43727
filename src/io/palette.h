/* palette: reduces pictures to at most 256 colours, for GIF. */
#ifndef SHERF_PALETTE_H
#define SHERF_PALETTE_H

#include "base/base.h"

enum { PALETTE_CLEAR = 255 }; /* the index for transparent pixels, if pictures have alpha */

typedef struct palette palette;
sherf_status palette_create(context *c, palette **out);
void palette_free(palette *p);
/* Chooses up to 256 colours for the pixels by median cut (255 with alpha: pixels less than half opaque are
 * PALETTE_CLEAR), and gives each pixel its index, dithered in a fixed pattern, so that still parts do not
 * flicker. rgba: pixels x 4. color: 256 of 0xAARRGGBB; index: rows of `stride` bytes. */
void palette_apply(palette *p, const uint8_t *rgba, int width, int height, bool alpha, uint32_t color[256],
                   uint8_t *index, int stride);
#endif
