/* image: HEIC and AVIF through libheif, which applies the container's own rotation and mirroring, so EXIF's
 * orientation is ignored. Of several pictures in a file the primary one is read. */
#include <libheif/heif.h>
#include <string.h>

#include "io/heif_stream.h"
#include "io/image_inside.h"

/* libheif limits the side of a square of pixels. */
enum { HEIF_SIDE_MAX = 11585 };
static const size_t exif_bytes_max = (size_t)1 << 20;

typedef struct {
    struct heif_context *file;
    struct heif_image_handle *handle;
    struct heif_image *picture;
    struct heif_decoding_options *options;
} heif_parts;

/* False: it failed, and the status says why. */
static bool went_well(image_decoder *d, const char *kind, struct heif_error error) {
    if (error.code == heif_error_Ok) return true;
    if (error.code == heif_error_Memory_allocation_error &&
        error.subcode != heif_suberror_Security_limit_exceeded)
        d->status = failure(d->c, SHERF_NO_MEMORY, "out of memory");
    else if (error.code == heif_error_Unsupported_feature || error.code == heif_error_Unsupported_filetype)
        d->status = failure(d->c, SHERF_UNSUPPORTED, "%s: %.200s", kind, error.message);
    else
        d->status = image_broken(d, kind, error.message);
    return false;
}

/* The first four bytes give the offset of the TIFF header after them. */
static void exif_from(image_decoder *d, const struct heif_image_handle *handle) {
    heif_item_id id;
    if (heif_image_handle_get_list_of_metadata_block_IDs(handle, "Exif", &id, 1) < 1) return;
    size_t bytes = heif_image_handle_get_metadata_size(handle, id);
    if (bytes < 4 || bytes > exif_bytes_max) return;
    uint8_t *data = mem_alloc(d->c, bytes, 1);
    if (!data) {
        d->status = SHERF_NO_MEMORY;
        return;
    }
    if (heif_image_handle_get_metadata(handle, id, data).code == heif_error_Ok) {
        size_t skip = (size_t)data[0] << 24 | (size_t)data[1] << 16 | (size_t)data[2] << 8 | data[3];
        if (skip <= bytes - 4) exif_read(data + 4 + skip, bytes - 4 - skip, &d->exif);
    }
    d->exif.orientation = 1;
    mem_free(data);
}

/* Reads an ICC profile, or else the code of the primaries. HDR curves (PQ, HLG) are not undone. */
static void profile_from(image_decoder *d, const struct heif_image_handle *handle) {
    struct heif_color_profile_nclx *nclx = NULL;
    const size_t bytes = heif_image_handle_get_raw_color_profile_size(handle);
    if (bytes && bytes <= profile_bytes_max) {
        uint8_t *data = mem_alloc(d->c, bytes, 1);
        if (!data)
            d->status = SHERF_NO_MEMORY;
        else if (heif_image_handle_get_raw_color_profile(handle, data).code == heif_error_Ok)
            image_profile_take(d, data, bytes);
        mem_free(data);
    } else if (bytes) {
        d->profile_fate = PROFILE_BROKEN;
    } else if (heif_image_handle_get_nclx_color_profile(handle, &nclx).code == heif_error_Ok && nclx) {
        d->primaries = (int)nclx->color_primaries;
    }
    heif_nclx_color_profile_free(nclx);
}

/* Divides premultiplied colours by alpha. */
static void undo_alpha(uint8_t *row, int width) {
    for (int i = 0; i < width; i++, row += 4)
        for (int k = 0; k < 3; k++) {
            int v = row[3] ? (row[k] * 255 + row[3] / 2) / row[3] : 0;
            row[k] = (uint8_t)(v > 255 ? 255 : v);
        }
}

static void put_rows(image_decoder *d, const char *kind, struct heif_image *picture, bool rgba,
                     bool multiplied) {
    int stride = 0, from = rgba ? 4 : 3;
    uint8_t *plane = heif_image_get_plane(picture, heif_channel_interleaved, &stride);
    if (!plane || heif_image_get_width(picture, heif_channel_interleaved) != d->out.width ||
        heif_image_get_height(picture, heif_channel_interleaved) != d->out.height ||
        stride < d->out.width * from) {
        d->status = image_broken(d, kind, "its size is not the one that it states");
        return;
    }
    if (!image_make_room(d, 0)) return;
    for (int y = 0; y < d->out.height; y++) {
        uint8_t *row = plane + (size_t)y * (size_t)stride;
        if (multiplied) undo_alpha(row, d->out.width);
        image_put_row(d, row, y, from);
    }
}

static void decode_picture(image_decoder *d, const char *kind, heif_parts *p) {
    bool multiplied = d->alpha && heif_image_handle_is_premultiplied_alpha(p->handle);
    bool rgba = d->alpha && (multiplied || d->channels == 4);
    p->options = heif_decoding_options_alloc();
    if (!p->options) {
        d->status = failure(d->c, SHERF_NO_MEMORY, "out of memory");
        return;
    }
    p->options->convert_hdr_to_8bit = 1;
    p->options->strict_decoding = 1;
    struct heif_error error =
        heif_decode_image(p->handle, &p->picture, heif_colorspace_RGB,
                          rgba ? heif_chroma_interleaved_RGBA : heif_chroma_interleaved_RGB, p->options);
    if (went_well(d, kind, error)) put_rows(d, kind, p->picture, rgba, multiplied);
}

/* libheif checks a frame's size only after the decoder has allocated its memory. A coded frame is slightly
 * larger than the visible part, and a picture's layers may state twice the size. */
static void check_streams(image_decoder *d, const char *kind) {
    heif_sizes sizes;
    if ((d->status = heif_stream_sizes(d->c, d->data, d->bytes, &sizes))) return;
    bool large = sizes.odd;
    for (int k = 0; k < 2; k++) large |= sizes.coded[k] > 2 * (uint64_t)sizes.stated[k] + 64;
    if (large)
        d->status = failure(d->c, SHERF_BAD_FILE,
                            "%s: its data are of %u x %u pixels, and it states %u x %u: damaged, or made to "
                            "harm",
                            kind, sizes.coded[0], sizes.coded[1], sizes.stated[0], sizes.stated[1]);
}

void image_heif_decode(image_decoder *d, const char *kind) {
    heif_parts p = {heif_context_alloc(), NULL, NULL, NULL};
    if (!p.file) {
        d->status = failure(d->c, SHERF_NO_MEMORY, "out of memory");
        return;
    }
    heif_context_set_maximum_image_size_limit(p.file, HEIF_SIDE_MAX);
    heif_context_set_max_decoding_threads(p.file, d->c->threads > 1 ? d->c->threads : 0);
    if (!went_well(d, kind, heif_context_read_from_memory_without_copy(p.file, d->data, d->bytes, NULL)) ||
        !went_well(d, kind, heif_context_get_primary_image_handle(p.file, &p.handle)))
        goto done;
    int width = heif_image_handle_get_width(p.handle), height = heif_image_handle_get_height(p.handle);
    if ((d->status = image_check_size(d, width > 0 ? (uint64_t)width : 0, height > 0 ? (uint64_t)height : 0)))
        goto done;
    d->alpha = heif_image_handle_has_alpha_channel(p.handle);
    d->own_channels = d->alpha ? 4 : 3;
    exif_from(d, p.handle);
    if (!d->status && d->photo) profile_from(d, p.handle);
    if (!d->status && d->channels) check_streams(d, kind);
    if (!d->status && d->channels) decode_picture(d, kind, &p);
done:
    heif_decoding_options_free(p.options);
    heif_image_release(p.picture);
    heif_image_handle_release(p.handle);
    heif_context_free(p.file);
}
