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

/* 2 channels have no PNG of colours; more than 4 have none at all. */
static sherf_status write_png(context *c, const char *path, const sherf_image *image) {
    size_t n = (size_t)image->width * (size_t)image->height * (size_t)image->channels;
    uint8_t *data = mem_alloc(c, n, 1);
    if (!data) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) data[i] = float_to_u8(image->data[i]);
    sherf_status status = png_write(c, path, image->width, image->height, image->channels, data);
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
    if (!path_ends(path, ".png"))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: pictures are written as .png or .npy", path);
    return write_png(c, path, image);
}
