/* Pictures. PNG (1-16 bit, grey, palette, alpha), JPEG (grey, YCbCr, CMYK), WebP, HEIC and AVIF are read as
 * 8-bit RGB or grey, upright as EXIF, PNG's eXIf or the container says. The first bytes determine the kind,
 * not the name. At most 32768 pixels on a side and 128 * 2^20 in all. Colour profiles are used for photos
 * only: pictures for scores are read as OpenCV reads them. */
#ifndef SHERF_IMAGE_H
#define SHERF_IMAGE_H

#include "base/base.h"

enum { IMAGE_SIDE_MAX = 32768, IMAGE_MASK = -1 };
static const size_t image_pixels_max = (size_t)128 << 20;

typedef struct {
    int width, height, channels;
    uint8_t *data;
} image_u8; /* mem_free(data) */
/* channels: the caller's choice of 3, 1 or 4 (grey from colour as in OpenCV: .299 .587 .114, a JPEG's Y as it
 * is; alpha is dropped unless 4 are requested, and 255 if the file has none). 16-bit values are scaled to 8.
 * CMYK JPEG: Adobe's inversion is respected. IMAGE_MASK: one channel, 1 where any colour of the file is not
 * 0, even a 16-bit one that would round to 0; else 0. The error names data that are not a picture. */
sherf_status image_read(context *c, const char *path, int channels, image_u8 *out);
/* The same from memory; channels 0: only reads the size, and data stays NULL. */
sherf_status image_parse(context *c, const unsigned char *data, size_t bytes, int channels, image_u8 *out);
/* channels: as in the file (a palette counts as colour). */
sherf_status image_size(context *c, const char *path, int *width, int *height, int *channels);

/* sRGB or no profile; another one, and the colours are now sRGB; an unreadable one, and the colours are as in
 * the file. */
typedef enum { PROFILE_NONE, PROFILE_TAKEN, PROFILE_BROKEN } profile_fate;

typedef struct {
    const char *kind;  /* "PNG", "JPEG", "WebP", "HEIC", "AVIF" */
    int width, height; /* upright */
    int channels;      /* as in the file (a palette counts as colour) */
    bool alpha;        /* the file has alpha: the picture has 4 channels, else 3 */
    int orientation;   /* the file's EXIF value: 1 upright; else the picture has been turned (HEIC and AVIF:
                          always 1) */
    profile_fate profile; /* known once the pixels have been read */
    float focal_px;       /* for the upright picture, from EXIF; 0 if it does not say (io/exif.h) */
} photo_info;
/* Reads a photo as a camera or phone wrote it, in sRGB. 40 megapixels take at most 0.3 GB and, for a
 * HEIC, 3.3 s (JPEG 0.8) on two cores. */
sherf_status image_photo_read(context *c, const char *path, image_u8 *out, photo_info *info);
sherf_status image_photo_info(context *c, const char *path,
                              photo_info *info); /* without decoding the pixels */
sherf_status image_photo_parse(context *c, const unsigned char *data, size_t bytes, image_u8 *out,
                               photo_info *info);

/* ---- image_kind.c: n bytes from a file's beginning, of which IMAGE_KIND_BYTES are enough ---- */
enum { IMAGE_KIND_BYTES = 512 };
/* "PNG", "JPEG", "WebP", "HEIC", "AVIF", or NULL for other data. */
const char *image_kind(const unsigned char *data, size_t n);
const char *image_file_kind(const char *path); /* NULL also if the file cannot be read */
/* Names a format that is not supported, as "a GIF"; NULL: unknown. */
const char *image_other_kind(const unsigned char *data, size_t n);

/* Sets the same as a failure's message, if the format is known; a text that may be a pickle keeps its own
 * message. */
void image_other_name(context *c, const unsigned char *data, size_t bytes);

/* ---- image_write.c ---- channels 1, 3 or 4; 8 bit. */
sherf_status png_write(context *c, const char *path, int width, int height, int channels,
                       const uint8_t *data);
/* Quality from 90 keeps colour at full size. */
sherf_status jpeg_write(context *c, const char *path, int width, int height, const uint8_t *rgb, int quality);
/* Lossless; 3 or 4 channels. */
sherf_status webp_write(context *c, const char *path, int width, int height, int channels,
                        const uint8_t *data);
/* The same to memory, freed with mem_free. level: zlib's, 0 to 9. */
sherf_status png_to_memory(context *c, int width, int height, int channels, const uint8_t *data, int level,
                           uint8_t **out, size_t *bytes);
sherf_status jpeg_to_memory(context *c, int width, int height, const uint8_t *rgb, int quality, uint8_t **out,
                            size_t *bytes);
/* The level that png_write uses: 4; for large pictures 1, which takes a third of the time for files a tenth
 * larger. */
int png_level(int width, int height);
uint8_t float_to_u8(float v); /* clamped, v * 255 rounded to nearest */
#endif
