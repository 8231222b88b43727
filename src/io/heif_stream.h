/* heif_stream: the frame sizes that the coded pictures of a HEIC or AVIF file state in their own headers. The
 * decoders take the memory for these, whatever the container says. ISO/IEC 14496-12, 14496-15, 23008-12;
 * H.265; AV1. */
#ifndef SHERF_HEIF_STREAM_H
#define SHERF_HEIF_STREAM_H

#include "base/base.h"

typedef struct {
    uint32_t stated[2]; /* the largest width and height of any picture by the container (ispe) */
    uint32_t coded[2];  /* by the headers of the streams: in av1C and hvcC boxes and in the pictures' data */
    bool odd;           /* a picture's data are more than the file, or numbered beyond what is followed */
} heif_sizes;

/* Whatever is broken counts as not said. Fails only for want of memory. */
sherf_status heif_stream_sizes(context *c, const uint8_t *data, size_t bytes, heif_sizes *out);
#endif
