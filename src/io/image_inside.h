/* image: shared by the decoders. */
#ifndef SHERF_IMAGE_INSIDE_H
#define SHERF_IMAGE_INSIDE_H

#include <setjmp.h>

#include "io/exif.h"
#include "io/image.h"

typedef struct {
    context *c;
    const unsigned char *data;
    size_t bytes, at;
    sherf_status status;
    jmp_buf back; /* of libpng and libjpeg */
    char text[200];
    image_u8 out;
    unsigned char *row;   /* scratch: a row, or the whole picture when interlaced */
    unsigned char **rows; /* interlaced PNG */
    int channels;         /* wanted; 0: only the size */
    bool mask; /* one channel: 1 where any colour of the file is not 0, with all 16 bits compared */
    int own_channels;
    bool alpha;             /* the file has alpha */
    bool photo;             /* converts colours by the profile */
    unsigned char *profile; /* ICC's, mem_free */
    size_t profile_bytes;
    int primaries; /* of HEIC and AVIF without a profile: H.273's code, 0 for none */
    profile_fate profile_fate;
    exif_facts exif; /* its orientation: how the decoded picture must still be turned */
} image_decoder;

/* These set d->status and, on success, store the picture in d->out. */
void image_webp_decode(image_decoder *d);
void image_heif_decode(image_decoder *d, const char *kind);

/* ---- image_rows.c ---- */
/* SHERF_BAD_FILE: the message for a file with bad data. */
sherf_status image_broken(image_decoder *d, const char *kind, const char *why);
/* Sets the size of d->out, or fails if it exceeds the limits. */
sherf_status image_check_size(image_decoder *d, uint64_t width, uint64_t height);
/* Allocates d->out.data, and d->row of row_bytes (0: none). */
bool image_make_room(image_decoder *d, size_t row_bytes);
/* Converts a row of `from` channels (1, 2: grey, alpha; 3, 4) to row y of the picture. */
void image_put_row(image_decoder *d, const uint8_t *row, int y, int from);

/* ---- image_profile.c ---- */
static const size_t profile_bytes_max = (size_t)4 << 20; /* longer ones count as broken */
/* Copies an ICC profile to d->profile if it is wanted; false, with d->status: out of memory. */
bool image_profile_take(image_decoder *d, const void *data, size_t bytes);
/* Converts the colours of d->out to sRGB; ignores an unreadable profile. */
void image_profile_apply(image_decoder *d);
#endif
