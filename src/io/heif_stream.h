/* heif_stream: the frame sizes in the own headers of a HEIC or AVIF file's coded pictures. Decoders allocate
 * memory for these sizes, whatever the container says. ISO/IEC 14496-12, 14496-15, 23008-12; H.265; AV1. */
#ifndef SHERF_HEIF_STREAM_H
#define SHERF_HEIF_STREAM_H

#include "base/base.h"

typedef struct {
    uint32_t stated[2]; /* the largest width and height of any picture according to the container (ispe) */
    uint32_t coded[2];  /* by the streams' headers: in av1C and hvcC boxes and in the pictures' data */
    bool odd;           /* a picture's data are larger than the file, or its number is out of range */
} heif_sizes;

/* Broken fields count as missing. Fails only when out of memory. */
sherf_status heif_stream_sizes(context *c, const uint8_t *data, size_t bytes, heif_sizes *out);
#endif
