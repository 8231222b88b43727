/* Pictures and videos. PNG (1-16 bit, grey, palette, alpha) and JPEG (grey, YCbCr, CMYK) come in as 8-bit RGB
 * or grey. */
#ifndef SHERF_IMAGE_H
#define SHERF_IMAGE_H

#include "base/base.h"

enum { IMAGE_SIDE_MAX = 32768, IMAGE_MASK = -1 };
static const size_t image_pixels_max = (size_t)128 << 20;

typedef struct {
    int width, height, channels;
    uint8_t *data;
} image_u8; /* mem_free(data) */
/* channels: 3, 1 or 4, what the caller wants (grey from colour as OpenCV: .299 .587 .114, a JPEG's Y as it
 * is; alpha is dropped unless 4 are asked for, 255 where there is none). 16-bit values are scaled to 8. CMYK
 * JPEG: Adobe inversion respected. A JPEG is turned upright when its EXIF says so. IMAGE_MASK: one channel, 1
 * where any colour of the file is not 0, also where a 16-bit one would round to 0; else 0. */
sherf_status image_read(context *c, const char *path, int channels, image_u8 *out);
/* The same from memory; channels 0: only the size, data stays NULL. */
sherf_status image_parse(context *c, const unsigned char *data, size_t bytes, int channels, image_u8 *out);
/* channels: as in the file (a palette counts as colour). */
sherf_status image_size(context *c, const char *path, int *width, int *height, int *channels);
/* channels 1, 3 or 4; 8 bit. */
sherf_status png_write(context *c, const char *path, int width, int height, int channels,
                       const uint8_t *data);
/* Quality from 90 keeps colour at full size. */
sherf_status jpeg_write(context *c, const char *path, int width, int height, const uint8_t *rgb, int quality);
/* The same to memory, freed with mem_free. level: zlib's, 0 to 9. */
sherf_status png_to_memory(context *c, int width, int height, int channels, const uint8_t *data, int level,
                           uint8_t **out, size_t *bytes);
sherf_status jpeg_to_memory(context *c, int width, int height, const uint8_t *rgb, int quality, uint8_t **out,
                            size_t *bytes);
uint8_t float_to_u8(float v); /* clamped, v * 255 rounded to nearest */
#endif
