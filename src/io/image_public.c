/* The public picture: floats in [0, 1]. */
#include <string.h>

#include "base/path.h"
#include "io/image.h"
#include "io/value.h"

void sherf_image_free(sherf_image *image) {
    if (!image) return;
    mem_free(image->data);
    *image = (sherf_image){0};
}

void sherf_frame_free(sherf_frame *frame) {
    sherf_image_free(&frame->color);
    sherf_image_free(&frame->opacity);
    sherf_image_free(&frame->depth);
    frame->points = 0;
}

sherf_status sherf_image_read(sherf_context *c, const char *path, sherf_image *out) {
    image_u8 picture;
    *out = (sherf_image){0};
    sherf_status status = image_read(c, path, 3, &picture);
    if (status != SHERF_OK) return status;
    size_t n = (size_t)picture.width * (size_t)picture.height * 3;
    float *data = mem_alloc(c, n, sizeof *data);
    if (data) {
        for (size_t i = 0; i < n; i++) data[i] = (float)picture.data[i] / 255.0f;
        *out = (sherf_image){picture.width, picture.height, 3, data};
    }
    mem_free(picture.data);
    return data ? SHERF_OK : SHERF_NO_MEMORY;
}

const char *sherf_image_kind(const char *path) {
    return image_file_kind(path);
}

enum { JPEG_QUALITY = 95 };

/* Grey is tripled if more channels are wanted; the caller mem_frees `to`. */
static sherf_status to_bytes(context *c, const sherf_image *image, int channels, uint8_t **to) {
    const size_t n = (size_t)image->width * (size_t)image->height, given = (size_t)image->channels;
    *to = mem_alloc(c, n, (size_t)channels);
    for (size_t i = 0; i < n && *to; i++)
        for (size_t k = 0; k < (size_t)channels; k++)
            (*to)[i * (size_t)channels + k] = float_to_u8(image->data[i * given + (given == 1 ? 0 : k)]);
    return *to ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status write_picture(context *c, const char *path, const sherf_image *image) {
    const bool png = path_ends(path, ".png"), webp = path_ends(path, ".webp");
    const int given = image->channels, channels = !png && given == 1 ? 3 : given;
    uint8_t *data;
    if (!png && channels != 3 && (!webp || channels != 4))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: %s", path,
                       channels == 4 ? "JPEG has no transparency; .png and .webp have"
                                     : "pictures have 1, 3 or 4 channels");
    sherf_status status = to_bytes(c, image, channels, &data);
    if (status) return status;
    status = png    ? png_write(c, path, image->width, image->height, channels, data)
             : webp ? webp_write(c, path, image->width, image->height, channels, data)
                    : jpeg_write(c, path, image->width, image->height, data, JPEG_QUALITY);
    mem_free(data);
    return status;
}

sherf_status sherf_image_write(sherf_context *c, const char *path, const sherf_image *image) {
    if (!image->data || image->width < 1 || image->height < 1 || image->channels < 1 ||
        image->width > IMAGE_SIDE_MAX || image->height > IMAGE_SIDE_MAX || image->channels > 64)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: the picture is empty or too large", path);
    int64_t dim[3] = {image->height, image->width, image->channels};
    if (path_ends(path, ".npy"))
        return npy_write_f32(c, path, image->channels == 1 ? 2 : 3, dim, image->data);
    if (sherf_output_kind(path) != SHERF_OUTPUT_PICTURE)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: pictures are written as .png, .jpg, .webp or .npy", path);
    return write_picture(c, path, image);
}
