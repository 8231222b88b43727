/* exif: the fields of a camera's EXIF data that are needed here. Exif 2.32, JEITA CP-3451. */
#ifndef SHERF_EXIF_H
#define SHERF_EXIF_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    int orientation; /* 1 upright ... 8; 1 if missing */
    /* 0 if missing: */
    double focal_35mm_mm; /* of a lens with the same view on 35 mm film */
    double focal_mm;
    double focal_plane_px_per_mm; /* of the sensor, along the width of the picture as taken */
    uint32_t width_px, height_px; /* of the picture as taken */
} exif_facts;

/* data: a TIFF header and the bytes after it; "Exif\0\0" may precede it. Broken fields count as missing. */
void exif_read(const uint8_t *data, size_t bytes, exif_facts *out);

/* Focal length in pixels for a picture of this size, upright or not. 0: unknown, since no field says it, the
 * value is implausible, or the picture was cropped (its shape differs from the one in `e`). */
double exif_focal_px(const exif_facts *e, int width_px, int height_px);
#endif
