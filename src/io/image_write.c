/* Pictures to memory, and from there to files: PNG through libpng, JPEG through libjpeg-turbo. */
#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#include <jpeglib.h>
#include <webp/encode.h>

#include "base/only_read.h"
#include "base/path.h"
#include "io/image.h"

/* Buffers that grow during writing; kept apart from the setjmp frame, which only points to them. */
typedef struct {
    context *c;
    uint8_t *data;
    size_t bytes, room;
    sherf_status status;
    jmp_buf back;
    char text[200];
} growing;

static bool grow(growing *g, size_t bytes) {
    if (bytes <= g->room) return true;
    size_t room = g->room ? 2 * g->room : (size_t)1 << 14;
    while (room < bytes) room *= 2;
    uint8_t *data = mem_grow(g->c, g->data, g->bytes, room, 1);
    if (!data) return false;
    g->data = data;
    g->room = room;
    return true;
}

static sherf_status finish(growing *g, const char *what, uint8_t **out, size_t *bytes) {
    if (g->status == SHERF_OK && g->text[0])
        g->status = failure(g->c, SHERF_WRITE_FAILED, "%s: %s", what, g->text);
    sherf_status status = g->status;
    if (status == SHERF_OK) {
        *out = g->data;
        *bytes = g->bytes;
    } else {
        mem_free(g->data);
    }
    mem_free(g);
    return status;
}

static growing *start(context *c, const char *what, int width, int height, sherf_status *status) {
    *status = SHERF_NO_MEMORY;
    if (width < 1 || height < 1 || width > IMAGE_SIDE_MAX || height > IMAGE_SIDE_MAX) {
        *status = failure(c, SHERF_BAD_ARGUMENT, "%s: a picture of %d x %d pixels cannot be written", what,
                          width, height);
        return NULL;
    }
    growing *g = mem_zero(c, 1, sizeof *g);
    if (g) g->c = c;
    return g;
}

/* ---- PNG ---- */
enum { PNG_LARGE = 8 << 20 }; /* pixels */

static void png_failed(png_structp png, png_const_charp text) {
    growing *g = png_get_error_ptr(png);
    snprintf(g->text, sizeof g->text, "%s", text);
    longjmp(g->back, 1);
}

static void png_warned(png_structp png, png_const_charp text) {
    (void)png;
    (void)text;
}

static png_voidp png_memory(png_structp png, png_alloc_size_t n) {
    growing *g = png_get_mem_ptr(png);
    void *p = mem_alloc(g->c, n, 1);
    if (!p) g->status = SHERF_NO_MEMORY;
    return p;
}

static void png_memory_free(png_structp png, png_voidp p) {
    (void)png;
    mem_free(p);
}

static void png_out(png_structp png, png_bytep data, png_size_t n) {
    growing *g = png_get_io_ptr(png);
    if (!grow(g, g->bytes + n)) {
        g->status = SHERF_NO_MEMORY;
        longjmp(g->back, 1);
    }
    memcpy(g->data + g->bytes, data, n);
    g->bytes += n;
}

static void png_flush_nothing(png_structp png) {
    (void)png;
}

static void png_run(growing *g, int width, int height, int channels, const uint8_t *data, int level) {
    png_infop volatile info = NULL;
    png_structp volatile png = png_create_write_struct_2(PNG_LIBPNG_VER_STRING, g, png_failed, png_warned, g,
                                                         png_memory, png_memory_free);
    if (!png) {
        g->status = SHERF_NO_MEMORY;
        return;
    }
    if (!setjmp(g->back)) {
        info = png_create_info_struct(png);
        if (!info) png_error(png, "no memory");
        int type = channels == 1   ? PNG_COLOR_TYPE_GRAY
                   : channels == 3 ? PNG_COLOR_TYPE_RGB
                                   : PNG_COLOR_TYPE_RGB_ALPHA;
        png_set_write_fn(png, g, png_out, png_flush_nothing);
        png_set_compression_level(png, level);
        if (level < 2) png_set_filter(png, 0, PNG_FILTER_SUB);
        png_set_IHDR(png, info, (png_uint_32)width, (png_uint_32)height, 8, type, PNG_INTERLACE_NONE,
                     PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
        png_write_info(png, info);
        for (int y = 0; y < height; y++)
            png_write_row(png, data + (size_t)y * (size_t)width * (size_t)channels);
        png_write_end(png, NULL);
    }
    png_structp p = png;
    png_infop i = info;
    png_destroy_write_struct(&p, &i);
}

int png_level(int width, int height) {
    return (int64_t)width * height >= PNG_LARGE ? 1 : 4;
}

sherf_status png_to_memory(context *c, int width, int height, int channels, const uint8_t *data, int level,
                           uint8_t **out, size_t *bytes) {
    sherf_status status;
    *out = NULL;
    if (channels != 1 && channels != 3 && channels != 4)
        return failure(c, SHERF_BAD_ARGUMENT, "PNG: pictures have 1, 3 or 4 channels, not %d", channels);
    growing *g = start(c, "PNG", width, height, &status);
    if (!g) return status;
    png_run(g, width, height, channels, data, level < 0 ? 0 : level > 9 ? 9 : level);
    return finish(g, "PNG", out, bytes);
}

/* ---- JPEG ---- */
typedef struct {
    struct jpeg_error_mgr base;
    growing *g;
} jpeg_error;

static void jpeg_failed(j_common_ptr j) {
    growing *g = ((jpeg_error *)j->err)->g;
    char text[JMSG_LENGTH_MAX];
    j->err->format_message(j, text);
    snprintf(g->text, sizeof g->text, "%.190s", text);
    longjmp(g->back, 1);
}

static void jpeg_silent(j_common_ptr j) {
    (void)j;
}

/* Gives all the room to the encoder. */
static void jpeg_room(j_compress_ptr j, size_t used, size_t wanted) {
    growing *g = j->client_data;
    g->bytes = used;
    if (!grow(g, wanted)) {
        g->status = SHERF_NO_MEMORY;
        longjmp(g->back, 1);
    }
    j->dest->next_output_byte = g->data + used;
    j->dest->free_in_buffer = g->room - used;
}

static void jpeg_start(j_compress_ptr j) {
    jpeg_room(j, 0, 1);
}

static boolean jpeg_full(j_compress_ptr j) {
    growing *g = j->client_data;
    jpeg_room(j, g->room, g->room + 1);
    return TRUE;
}

static void jpeg_end(j_compress_ptr j) {
    growing *g = j->client_data;
    g->bytes = g->room - j->dest->free_in_buffer;
}

static void jpeg_run(growing *g, int width, int height, const uint8_t *rgb, int quality) {
    struct jpeg_compress_struct j = {0};
    jpeg_error error = {.g = g};
    struct jpeg_destination_mgr destination = {
        .init_destination = jpeg_start, .empty_output_buffer = jpeg_full, .term_destination = jpeg_end};
    j.err = jpeg_std_error(&error.base);
    error.base.error_exit = jpeg_failed;
    error.base.output_message = jpeg_silent;
    if (setjmp(g->back)) {
        jpeg_destroy_compress(&j);
        return;
    }
    jpeg_create_compress(&j);
    j.client_data = g;
    j.dest = &destination;
    j.image_width = (JDIMENSION)width;
    j.image_height = (JDIMENSION)height;
    j.input_components = 3;
    j.in_color_space = JCS_RGB;
    jpeg_set_defaults(&j);
    jpeg_set_quality(&j, quality, TRUE);
    if (quality >= 90) j.comp_info[0].h_samp_factor = j.comp_info[0].v_samp_factor = 1; /* full colour */
    jpeg_start_compress(&j, TRUE);
    while (j.next_scanline < j.image_height) {
        JSAMPROW row = only_read(rgb + (size_t)j.next_scanline * (size_t)width * 3);
        jpeg_write_scanlines(&j, &row, 1);
    }
    jpeg_finish_compress(&j);
    jpeg_destroy_compress(&j);
}

sherf_status jpeg_to_memory(context *c, int width, int height, const uint8_t *rgb, int quality, uint8_t **out,
                            size_t *bytes) {
    sherf_status status;
    *out = NULL;
    if (quality < 1 || quality > 100)
        return failure(c, SHERF_BAD_ARGUMENT, "JPEG: quality is 1 to 100, not %d", quality);
    growing *g = start(c, "JPEG", width, height, &status);
    if (!g) return status;
    jpeg_run(g, width, height, rgb, quality);
    return finish(g, "JPEG", out, bytes);
}

/* ---- files ---- */
/* Writes the encoded picture, which it takes over, to a file. */
static sherf_status to_file(context *c, const char *path, sherf_status status, uint8_t *data, size_t bytes) {
    output_file file;
    if (status != SHERF_OK) return failure_prefix(c, status, "%s", path);
    status = output_open(c, path, &file);
    if (status == SHERF_OK) {
        status = output_write(c, &file, data, bytes);
        if (status == SHERF_OK) status = output_commit(c, &file);
        output_abort(&file);
    }
    mem_free(data);
    return status;
}

sherf_status png_write(context *c, const char *path, int width, int height, int channels,
                       const uint8_t *data) {
    uint8_t *png = NULL;
    size_t bytes = 0;
    sherf_status status =
        png_to_memory(c, width, height, channels, data, png_level(width, height), &png, &bytes);
    return to_file(c, path, status, png, bytes);
}

sherf_status jpeg_write(context *c, const char *path, int width, int height, const uint8_t *rgb,
                        int quality) {
    uint8_t *jpeg = NULL;
    size_t bytes = 0;
    sherf_status status = jpeg_to_memory(c, width, height, rgb, quality, &jpeg, &bytes);
    return to_file(c, path, status, jpeg, bytes);
}

sherf_status webp_write(context *c, const char *path, int width, int height, int channels,
                        const uint8_t *data) {
    uint8_t *packed = NULL, *own = NULL;
    if (width > WEBP_MAX_DIMENSION || height > WEBP_MAX_DIMENSION || (channels != 3 && channels != 4))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: WebP has 3 or 4 channels and at most %d pixels on a side",
                       path, WEBP_MAX_DIMENSION);
    const size_t bytes = channels == 4 ? WebPEncodeLosslessRGBA(data, width, height, width * 4, &packed)
                                       : WebPEncodeLosslessRGB(data, width, height, width * 3, &packed);
    if (bytes) own = mem_alloc(c, bytes, 1); /* to_file takes over memory of ours only */
    if (own) memcpy(own, packed, bytes);
    WebPFree(packed);
    if (!bytes) return failure(c, SHERF_NO_MEMORY, "%s: WebP cannot be encoded", path);
    return own ? to_file(c, path, SHERF_OK, own, bytes) : SHERF_NO_MEMORY;
}
