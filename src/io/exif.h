/* exif: what a camera wrote beside its picture, as far as it is needed here. Exif 2.32, JEITA CP-3451. */
#ifndef SHERF_EXIF_H
#define SHERF_EXIF_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    int orientation; /* 1 upright ... 8; 1 when nothing is said */
    /* 0 where nothing is said: */
    double focal_35mm_mm; /* of a lens with the same view on 35 mm film */
    double focal_mm;
    double focal_plane_px_per_mm; /* of the sensor, along the picture's width as it was taken */
    uint32_t width_px, height_px; /* of the picture as it was taken */
} exif_facts;

/* data: a TIFF header and what follows it; "Exif\0\0" may stand before. Whatever is broken counts as not
 * said. */
void exif_read(const uint8_t *data, size_t bytes, exif_facts *out);

/* Focal length in pixels of a picture of this size, upright or not; 0 where it cannot be told: nothing is
 * said, the value is out of reason, or the picture has been cut out of another (its shape is not the one in
 * `e`). */
double exif_focal_px(const exif_facts *e, int width_px, int height_px);
#endif
