/* image: shared by all decoders: sets a picture's size, stores rows, reports errors. */
#include <string.h>

#include "io/image_inside.h"

typedef image_decoder decoder;

sherf_status image_broken(decoder *d, const char *kind, const char *why) {
    int length = (int)strlen(why);
    while (length && (why[length - 1] == ' ' || why[length - 1] == '.')) length--;
    return failure(d->c, SHERF_BAD_FILE, "%s: %.*s (damaged, or not copied whole: get the file again)", kind,
                   length < 200 ? length : 200, why);
}

sherf_status image_check_size(decoder *d, uint64_t width, uint64_t height) {
    if (!width || !height || width > IMAGE_SIDE_MAX || height > IMAGE_SIDE_MAX ||
        width * height > image_pixels_max)
        return failure(d->c, SHERF_BAD_FILE,
                       "a picture of %llu x %llu pixels: from 1 to %d on a side and %zu in all are read",
                       (unsigned long long)width, (unsigned long long)height, IMAGE_SIDE_MAX,
                       image_pixels_max);
    d->out.width = (int)width;
    d->out.height = (int)height;
    return SHERF_OK;
}

bool image_make_room(decoder *d, size_t row_bytes) {
    d->out.channels = d->channels;
    d->out.data = mem_alloc(d->c, (size_t)d->out.width * (size_t)d->out.height, (size_t)d->channels);
    if (d->out.data && row_bytes) d->row = mem_alloc(d->c, row_bytes, 1);
    bool there = d->out.data && (d->row || !row_bytes);
    if (!there) d->status = SHERF_NO_MEMORY;
    return there;
}

/* Grey as in libpng (and so OpenCV): 15-bit fixed point, truncated; grey pixels stay as they are. */
static uint8_t grey_of(const uint8_t *p) {
    if (p[0] == p[1] && p[0] == p[2]) return p[0];
    return (uint8_t)((9797 * p[0] + 19234 * p[1] + 3737 * p[2]) >> 15);
}

void image_put_row(decoder *d, const uint8_t *row, int y, int from) {
    size_t width = (size_t)d->out.width;
    uint8_t *to = d->out.data + (size_t)y * width * (size_t)d->channels;
    if (d->mask) {
        for (size_t i = 0; i < width; i++, row += from) to[i] = row[0] || (from > 2 && (row[1] || row[2]));
        return;
    }
    if (from == d->channels) {
        memcpy(to, row, width * (size_t)from);
        return;
    }
    for (size_t i = 0; i < width; i++, row += from, to += d->channels) {
        bool grey = from < 3;
        if (d->channels == 1)
            to[0] = grey ? row[0] : grey_of(row);
        else {
            to[0] = row[0];
            to[1] = row[grey ? 0 : 1];
            to[2] = row[grey ? 0 : 2];
            if (d->channels == 4) to[3] = from == 4 ? row[3] : from == 2 ? row[1] : 255;
        }
    }
}
