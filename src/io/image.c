/* image: PNG through libpng, JPEG through libjpeg-turbo; image_webp.c and image_heif.c have the others. Both
 * libraries report errors by longjmp; memory to free is kept in a struct that the setjmp frame only points
 * to. Decoding is the same as OpenCV's (slow DCT, fancy upsampling, upright by EXIF), so that scores agree.
 */
#include <errno.h>
#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <jpeglib.h>

#include <jerror.h>

#include "base/path.h"
#include "io/image_inside.h"

enum { JPEG_SCANS = 200 };
static const size_t image_bytes_max = (size_t)1 << 30;

typedef image_decoder decoder;

/* ---------------------------------------------------------------- PNG -------------------------------- */
static void png_bytes(png_structp png, png_bytep out, png_size_t n) {
    decoder *d = png_get_io_ptr(png);
    if (n > d->bytes - d->at) png_error(png, "truncated");
    memcpy(out, d->data + d->at, n);
    d->at += n;
}

static void png_failed(png_structp png, png_const_charp text) {
    decoder *d = png_get_error_ptr(png);
    snprintf(d->text, sizeof d->text, "%s", text);
    longjmp(d->back, 1);
}

static void png_warned(png_structp png, png_const_charp text) {
    (void)png;
    (void)text;
}

static png_voidp png_memory(png_structp png, png_alloc_size_t n) {
    decoder *d = png_get_mem_ptr(png);
    void *p = mem_alloc(d->c, n, 1);
    if (!p) d->status = SHERF_NO_MEMORY;
    return p;
}

static void png_memory_free(png_structp png, png_voidp p) {
    (void)png;
    mem_free(p);
}

/* Converts to 8 bits; palette and transparent colours become RGB and alpha. A mask keeps its 16 bits. */
static void png_transforms(const decoder *d, png_structp png, png_infop info) {
    int type = png_get_color_type(png, info), depth = png_get_bit_depth(png, info);
    if (depth == 16 && !d->mask) png_set_scale_16(png);
    if (type == PNG_COLOR_TYPE_PALETTE) png_set_palette_to_rgb(png);
    if (type == PNG_COLOR_TYPE_GRAY && depth < 8) png_set_expand_gray_1_2_4_to_8(png);
    if (png_get_valid(png, info, PNG_INFO_tRNS)) png_set_tRNS_to_alpha(png);
}

/* Stores a row of a PNG; for a mask of 16-bit samples, whether they are 0. */
static void png_put_row(decoder *d, uint8_t *row, int y, int from, bool deep) {
    if (deep)
        for (size_t i = 0; i < (size_t)d->out.width * (size_t)from; i++)
            row[i] = row[2 * i] || row[2 * i + 1];
    image_put_row(d, row, y, from);
}

static void png_rows(decoder *d, png_structp png, png_infop info) {
    int passes = png_set_interlace_handling(png);
    png_read_update_info(png, info);
    int from = png_get_channels(png, info);
    size_t row_bytes = png_get_rowbytes(png, info), height = (size_t)d->out.height;
    bool deep = png_get_bit_depth(png, info) == 16;
    if (from < 1 || from > 4 || row_bytes != (size_t)d->out.width * (size_t)from * (deep ? 2 : 1))
        png_error(png, "odd rows");
    if (!image_make_room(d, passes > 1 ? row_bytes * height : row_bytes)) longjmp(d->back, 1);
    if (passes > 1) {
        d->rows = mem_alloc(d->c, height, sizeof *d->rows);
        if (!d->rows) {
            d->status = SHERF_NO_MEMORY;
            longjmp(d->back, 1);
        }
        for (size_t y = 0; y < height; y++) d->rows[y] = d->row + y * row_bytes;
        png_read_image(png, d->rows);
        for (size_t y = 0; y < height; y++) png_put_row(d, d->rows[y], (int)y, from, deep);
    } else
        for (size_t y = 0; y < height; y++) {
            png_read_row(png, d->row, NULL);
            png_put_row(d, d->row, (int)y, from, deep);
        }
    png_read_end(png, NULL); /* checks the last checksums, too */
}

/* The eXIf chunk may also follow the pixels, which libpng has not read yet. */
static void png_exif(decoder *d) {
    for (size_t at = 8; at + 12 <= d->bytes;) {
        const unsigned char *p = d->data + at;
        size_t length = (size_t)p[0] << 24 | (size_t)p[1] << 16 | (size_t)p[2] << 8 | p[3];
        if (length > d->bytes - at - 12) return;
        if (!memcmp(p + 4, "eXIf", 4)) {
            exif_read(p + 8, length, &d->exif);
            return;
        }
        at += length + 12;
    }
}

static void png_profile(decoder *d, png_structp png, png_infop info) {
    png_charp name;
    png_bytep profile;
    png_uint_32 bytes;
    int method;
    if (png_get_iCCP(png, info, &name, &method, &profile, &bytes)) image_profile_take(d, profile, bytes);
}

static void png_decode(decoder *d) {
    png_infop volatile info = NULL;
    png_structp volatile png = png_create_read_struct_2(PNG_LIBPNG_VER_STRING, d, png_failed, png_warned, d,
                                                        png_memory, png_memory_free);
    if (!png) {
        d->status = SHERF_NO_MEMORY;
        return;
    }
    if (setjmp(d->back)) {
        if (d->status == SHERF_OK) d->status = image_broken(d, "PNG", d->text);
        goto done;
    }
    info = png_create_info_struct(png);
    if (!info) {
        d->status = SHERF_NO_MEMORY;
        goto done;
    }
    png_set_user_limits(png, IMAGE_SIDE_MAX, IMAGE_SIDE_MAX);
    png_set_chunk_cache_max(png, 128);
    png_set_chunk_malloc_max(png, (png_alloc_size_t)8 << 20);
    png_set_read_fn(png, d, png_bytes);
    png_read_info(png, info);
    d->status = image_check_size(d, png_get_image_width(png, info), png_get_image_height(png, info));
    int own = png_get_channels(png, info);
    d->own_channels = png_get_color_type(png, info) == PNG_COLOR_TYPE_PALETTE ? 3 : own;
    if (png_get_valid(png, info, PNG_INFO_tRNS)) d->own_channels++;
    d->alpha = d->own_channels == 2 || d->own_channels == 4;
    png_exif(d);
    png_profile(d, png, info);
    if (d->status == SHERF_OK && d->channels) {
        png_transforms(d, png, info);
        png_rows(d, png, info);
    }
done : {
    png_structp p = png;
    png_infop i = info;
    png_destroy_read_struct(&p, &i, NULL);
}
}

/* ---------------------------------------------------------------- JPEG ------------------------------- */
typedef struct {
    struct jpeg_error_mgr base;
    decoder *d;
} jpeg_error;

static void jpeg_failed(j_common_ptr j) {
    decoder *d = ((jpeg_error *)j->err)->d;
    char text[JMSG_LENGTH_MAX];
    j->err->format_message(j, text);
    snprintf(d->text, sizeof d->text, "%.190s", text);
    longjmp(d->back, 1);
}

/* Warnings: an incomplete picture is refused, oddities around the data are not. */
static void jpeg_warned(j_common_ptr j, int level) {
    int code = j->err->msg_code;
    if (level < 0 && code != JWRN_EXTRANEOUS_DATA && code != JWRN_ADOBE_XFORM && code != JWRN_JFIF_MAJOR)
        jpeg_failed(j);
}

/* A small progressive file can require thousands of passes over a large picture. */
static void jpeg_progressed(j_common_ptr j) {
    if (((j_decompress_ptr)j)->input_scan_number <= JPEG_SCANS) return;
    snprintf(((jpeg_error *)j->err)->d->text, 200, "more than %d scans", JPEG_SCANS);
    longjmp(((jpeg_error *)j->err)->d->back, 1);
}

static void jpeg_silent(j_common_ptr j) {
    (void)j;
}

/* CMYK to RGB with OpenCV's rounding. The formula takes inverted inks, as Adobe writes them. */
static void cmyk_to_rgb(uint8_t *row, size_t width, bool inverted) {
    uint8_t *to = row;
    for (size_t i = 0; i < width; i++, row += 4, to += 3) {
        int k = inverted ? row[3] : 255 - row[3];
        for (int x = 0; x < 3; x++) {
            int ink = inverted ? 255 - row[x] : row[x];
            to[x] = (uint8_t)(k - (ink * k >> 8));
        }
    }
}

static void jpeg_exif(decoder *d, const struct jpeg_decompress_struct *j) {
    for (jpeg_saved_marker_ptr marker = j->marker_list; marker; marker = marker->next)
        if (marker->marker == JPEG_APP0 + 1 && marker->data_length >= 6 &&
            !memcmp(marker->data, "Exif\0", 6)) {
            exif_read(marker->data, marker->data_length, &d->exif);
            return;
        }
}

static void jpeg_profile(decoder *d, struct jpeg_decompress_struct *j) {
    JOCTET *profile = NULL;
    unsigned bytes = 0;
    if (d->photo && jpeg_read_icc_profile(j, &profile, &bytes)) image_profile_take(d, profile, bytes);
    free(profile);
}

static void jpeg_rows(decoder *d, struct jpeg_decompress_struct *j) {
    bool cmyk = j->jpeg_color_space == JCS_CMYK || j->jpeg_color_space == JCS_YCCK;
    bool adobe = j->saw_Adobe_marker;
    j->dct_method = JDCT_ISLOW;
    j->do_fancy_upsampling = TRUE;
    /* a colour JPEG's grey is its Y, as in OpenCV */
    bool grey = j->num_components == 1 || (d->channels == 1 && !d->mask && j->jpeg_color_space == JCS_YCbCr);
    j->out_color_space = cmyk ? JCS_CMYK : grey ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_start_decompress(j);
    int from = j->output_components;
    if (from < 1 || from > 4 || j->output_width != (JDIMENSION)d->out.width ||
        j->output_height != (JDIMENSION)d->out.height) {
        snprintf(d->text, sizeof d->text, "an unusual layout");
        longjmp(d->back, 1);
    }
    if (!image_make_room(d, (size_t)d->out.width * (size_t)from)) longjmp(d->back, 1);
    while (j->output_scanline < j->output_height) {
        int y = (int)j->output_scanline;
        JSAMPROW row = d->row;
        if (jpeg_read_scanlines(j, &row, 1) != 1) continue;
        if (cmyk) cmyk_to_rgb(d->row, (size_t)d->out.width, adobe);
        image_put_row(d, d->row, y, cmyk ? 3 : from);
    }
    jpeg_finish_decompress(j);
}

static void jpeg_decode(decoder *d) {
    struct jpeg_decompress_struct j = {0};
    jpeg_error error = {.d = d};
    j.err = jpeg_std_error(&error.base);
    error.base.error_exit = jpeg_failed;
    error.base.emit_message = jpeg_warned;
    error.base.output_message = jpeg_silent;
    if (setjmp(d->back)) {
        if (d->status == SHERF_OK) d->status = image_broken(d, "JPEG", d->text);
        jpeg_destroy_decompress(&j);
        return;
    }
    jpeg_create_decompress(&j);
    j.mem->max_memory_to_use = 1L << 30;
    struct jpeg_progress_mgr progress_manager = {.progress_monitor = jpeg_progressed};
    j.progress = &progress_manager;
    jpeg_save_markers(&j, JPEG_APP0 + 1, 0xffff);
    if (d->photo) jpeg_save_markers(&j, JPEG_APP0 + 2, 0xffff);
    jpeg_mem_src(&j, d->data, d->bytes);
    jpeg_read_header(&j, TRUE);
    d->status = image_check_size(d, j.image_width, j.image_height);
    d->own_channels = j.num_components;
    jpeg_exif(d, &j);
    if (d->status == SHERF_OK) jpeg_profile(d, &j);
    if (d->status == SHERF_OK && d->channels) jpeg_rows(d, &j);
    jpeg_destroy_decompress(&j);
}

/* ---------------------------------------------------------------- reading ---------------------------- */
/* Where the pixel at (x, y) of the upright picture is in the file's picture: `at` + x * `right` + y * `down`
 * pixels. Orientations 5 to 8 swap rows and columns. */
typedef struct {
    ptrdiff_t at, right, down;
} turning;

static turning turning_of(int orientation, int w, int h) {
    bool swap = orientation >= 5;
    bool flip_u = orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8;
    bool flip_v = orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7;
    ptrdiff_t u = flip_u ? -1 : 1, v = flip_v ? -(ptrdiff_t)w : w;
    turning t = {(flip_u ? w - 1 : 0) + (flip_v ? (ptrdiff_t)(h - 1) * w : 0), swap ? v : u, swap ? u : v};
    return t;
}

/* Turns the picture upright, in squares that stay in cache. */
static void turn(decoder *d) {
    enum { SQUARE = 32 };
    int w = d->out.width, h = d->out.height, n = d->channels;
    bool swap = d->exif.orientation >= 5;
    int width = swap ? h : w, height = swap ? w : h;
    d->out.width = width;
    d->out.height = height;
    if (!n) return;
    uint8_t *to = mem_alloc(d->c, (size_t)w * (size_t)h, (size_t)n);
    if (!to) {
        d->status = SHERF_NO_MEMORY;
        return;
    }
    turning t = turning_of(d->exif.orientation, w, h);
    for (int y0 = 0; y0 < height; y0 += SQUARE)
        for (int x0 = 0; x0 < width; x0 += SQUARE)
            for (int y = y0; y < height && y < y0 + SQUARE; y++)
                for (int x = x0; x < width && x < x0 + SQUARE; x++) {
                    const uint8_t *from = d->out.data + (t.at + x * t.right + y * t.down) * n;
                    uint8_t *p = to + ((size_t)y * (size_t)width + (size_t)x) * (size_t)n;
                    for (int k = 0; k < n; k++) p[k] = from[k];
                }
    mem_free(d->out.data);
    d->out.data = to;
}

static void decode_any(decoder *d) {
    const char *kind = image_kind(d->data, d->bytes);
    if (!kind) {
        const char *other = image_other_kind(d->data, d->bytes);
        d->status = failure(d->c, SHERF_BAD_FILE, "%s%sPNG, JPEG, WebP, HEIC and AVIF are read",
                            other ? other : "", other ? "; " : "not a known picture; ");
    } else if (!strcmp(kind, "PNG")) {
        png_decode(d);
    } else if (!strcmp(kind, "JPEG")) {
        jpeg_decode(d);
    } else if (!strcmp(kind, "WebP")) {
        image_webp_decode(d);
    } else {
        image_heif_decode(d, kind);
    }
}

static sherf_status decode(decoder *d) {
    decode_any(d);
    if (d->status == SHERF_OK && d->photo && d->channels) image_profile_apply(d);
    if (d->status == SHERF_OK && d->exif.orientation > 1) turn(d);
    mem_free(d->profile);
    mem_free(d->row);
    mem_free(d->rows);
    if (d->status != SHERF_OK) {
        mem_free(d->out.data);
        d->out = (image_u8){0};
    }
    return d->status;
}

/* info may be NULL. */
static sherf_status parse(context *c, const unsigned char *data, size_t bytes, int channels, bool photo,
                          image_u8 *out, photo_info *info) {
    decoder *d = mem_zero(c, 1, sizeof *d);
    *out = (image_u8){0};
    if (!d) return SHERF_NO_MEMORY;
    d->c = c;
    d->data = data;
    d->bytes = bytes;
    d->mask = channels == IMAGE_MASK;
    d->channels = d->mask ? 1 : channels;
    d->photo = photo;
    d->exif.orientation = 1;
    sherf_status status = decode(d);
    *out = d->out;
    if (status == SHERF_OK && !channels) out->channels = d->own_channels;
    if (status == SHERF_OK && info)
        *info = (photo_info){.kind = image_kind(data, bytes),
                             .width = d->out.width,
                             .height = d->out.height,
                             .channels = d->own_channels,
                             .alpha = d->alpha,
                             .orientation = d->exif.orientation,
                             .profile = d->profile_fate,
                             .focal_px = (float)exif_focal_px(&d->exif, d->out.width, d->out.height)};
    mem_free(d);
    return status;
}

sherf_status image_parse(context *c, const unsigned char *data, size_t bytes, int channels, image_u8 *out) {
    return parse(c, data, bytes, channels, false, out, NULL);
}

static sherf_status read_file(context *c, const char *path, int channels, image_u8 *out) {
    unsigned char *data;
    size_t bytes;
    *out = (image_u8){0};
    sherf_status status = file_read(c, path, image_bytes_max, &data, &bytes);
    if (status != SHERF_OK) return status;
    status = image_parse(c, data, bytes, channels, out);
    mem_free(data);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

sherf_status image_photo_parse(context *c, const unsigned char *data, size_t bytes, image_u8 *out,
                               photo_info *info) {
    *info = (photo_info){0};
    sherf_status status = parse(c, data, bytes, 0, true, out, info);
    if (status == SHERF_OK) status = parse(c, data, bytes, info->alpha ? 4 : 3, true, out, info);
    return status;
}

static sherf_status photo_file(context *c, const char *path, bool pixels, image_u8 *out, photo_info *info) {
    unsigned char *data;
    size_t bytes;
    *out = (image_u8){0};
    *info = (photo_info){0};
    sherf_status status = file_read(c, path, image_bytes_max, &data, &bytes);
    if (status != SHERF_OK) return status;
    status =
        pixels ? image_photo_parse(c, data, bytes, out, info) : parse(c, data, bytes, 0, true, out, info);
    mem_free(data);
    if (status == SHERF_OK && info->profile == PROFILE_BROKEN)
        log_line(c, SHERF_LOG_WARNING, "%s: its colour profile cannot be read, its colours are taken as sRGB",
                 path);
    return status == SHERF_OK ? status : failure_prefix(c, status, "%s", path);
}

sherf_status image_photo_read(context *c, const char *path, image_u8 *out, photo_info *info) {
    return photo_file(c, path, true, out, info);
}

sherf_status image_photo_info(context *c, const char *path, photo_info *info) {
    image_u8 size;
    return photo_file(c, path, false, &size, info);
}

sherf_status image_read(context *c, const char *path, int channels, image_u8 *out) {
    *out = (image_u8){0};
    if (channels != 1 && channels != 3 && channels != 4 && channels != IMAGE_MASK)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: pictures have 1, 3 or 4 channels, not %d", path, channels);
    return read_file(c, path, channels, out);
}

sherf_status image_size(context *c, const char *path, int *width, int *height, int *channels) {
    image_u8 picture;
    sherf_status status = read_file(c, path, 0, &picture);
    *width = picture.width;
    *height = picture.height;
    *channels = picture.channels;
    return status;
}

uint8_t float_to_u8(float v) {
    return v >= 1 ? 255 : v > 0 ? (uint8_t)(v * 255 + 0.5f) : 0; /* NaN becomes 0 */
}
