/* exif: reads three TIFF directories. It follows only offsets inside the data, and visits each directory
 * once. */
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "io/exif.h"

enum { TYPE_SHORT = 3, TYPE_LONG = 4, TYPE_RATIONAL = 5 };
enum {
    TAG_ORIENTATION = 0x112,
    TAG_EXIF = 0x8769,
    TAG_FOCAL = 0x920a,
    TAG_WIDTH = 0xa002,
    TAG_HEIGHT = 0xa003,
    TAG_PLANE_X = 0xa20e,
    TAG_PLANE_UNIT = 0xa210,
    TAG_FOCAL_35MM = 0xa405
};

/* The diagonal of 36 x 24 mm: makers state the focal length that has the same diagonal angle of view on 35 mm
 * film. */
static const double film_diagonal_mm = 43.2666153;

typedef struct {
    const uint8_t *data;
    size_t bytes;
    bool big_endian;
    double plane_px_per_unit;
    unsigned plane_unit;
} reader;

static uint32_t number(const reader *r, size_t at, int bytes) {
    uint32_t n = 0;
    for (int i = 0; i < bytes; i++)
        n |= (uint32_t)r->data[at + (size_t)i] << 8 * (r->big_endian ? bytes - 1 - i : i);
    return n;
}

/* The first value of the entry at `at`; 0 for other types. */
static double entry_value(const reader *r, size_t at) {
    switch (number(r, at + 2, 2)) {
    case TYPE_SHORT:
        return number(r, at + 8, 2);
    case TYPE_LONG:
        return number(r, at + 8, 4);
    case TYPE_RATIONAL: {
        size_t to = number(r, at + 8, 4);
        if (to > r->bytes || r->bytes - to < 8) return 0;
        uint32_t below = number(r, to + 4, 4);
        return below ? (double)number(r, to, 4) / below : 0;
    }
    default:
        return 0;
    }
}

static void take(reader *r, unsigned tag, double v, exif_facts *out) {
    if (tag == TAG_ORIENTATION && v >= 1 && v <= 8) out->orientation = (int)v;
    if (tag == TAG_FOCAL) out->focal_mm = v;
    if (tag == TAG_FOCAL_35MM) out->focal_35mm_mm = v;
    if (tag == TAG_WIDTH) out->width_px = (uint32_t)v;
    if (tag == TAG_HEIGHT) out->height_px = (uint32_t)v;
    if (tag == TAG_PLANE_X) r->plane_px_per_unit = v;
    if (tag == TAG_PLANE_UNIT) r->plane_unit = (unsigned)v;
}

/* Reads the directory at `at`; returns the Exif directory's offset, 0 for none. The first directory has the
 * orientation, the other one the rest, so a thumbnail's or a maker's tags mislead neither. */
static size_t directory(reader *r, size_t at, bool first, exif_facts *out) {
    size_t next = 0;
    if (at > r->bytes || r->bytes - at < 2) return 0;
    uint32_t entries = number(r, at, 2);
    for (at += 2; entries-- && at + 12 <= r->bytes; at += 12) {
        unsigned tag = number(r, at, 2);
        if (first && tag == TAG_EXIF) next = (size_t)entry_value(r, at);
        if (first == (tag == TAG_ORIENTATION)) take(r, tag, entry_value(r, at), out);
    }
    return next;
}

void exif_read(const uint8_t *data, size_t bytes, exif_facts *out) {
    *out = (exif_facts){.orientation = 1};
    if (bytes >= 6 && !memcmp(data, "Exif\0", 6)) data += 6, bytes -= 6;
    if (bytes < 14 || (memcmp(data, "II", 2) && memcmp(data, "MM", 2))) return;
    reader r = {data, bytes, data[0] == 'M', 0, 2};
    size_t at = directory(&r, number(&r, 4, 4), true, out);
    if (at) directory(&r, at, false, out);
    /* inch, centimetre; millimetre and micrometre are not in the standard, but cameras write them */
    static const double unit_mm[] = {0, 0, 25.4, 10, 1, 0.001};
    if (r.plane_unit >= 2 && r.plane_unit < sizeof unit_mm / sizeof *unit_mm)
        out->focal_plane_px_per_mm = r.plane_px_per_unit / unit_mm[r.plane_unit];
}

double exif_focal_px(const exif_facts *e, int width_px, int height_px) {
    const double longer = fmax(width_px, height_px), shorter = fmin(width_px, height_px);
    double taken_longer = fmax(e->width_px, e->height_px), taken_shorter = fmin(e->width_px, e->height_px);
    double focal_px = 0;
    if (taken_shorter > 0 && fabs(taken_shorter / taken_longer - shorter / longer) > 0.01) return 0;
    if (!(taken_shorter > 0)) taken_longer = longer;
    if (e->focal_35mm_mm > 0)
        focal_px = e->focal_35mm_mm * hypot(longer, shorter) / film_diagonal_mm;
    else
        focal_px = e->focal_mm * e->focal_plane_px_per_mm * longer / taken_longer;
    /* views of 136 degrees to 1 degree */
    return focal_px >= 0.2 * longer && focal_px <= 50 * longer ? focal_px : 0;
}
