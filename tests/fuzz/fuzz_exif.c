/* Fuzz target: EXIF. A focal length that it gives must be valid. */
#include <math.h>

#include "fuzz.h"
#include "io/exif.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    exif_facts facts;
    exif_read(data, size, &facts);
    if (facts.orientation < 1 || facts.orientation > 8) abort();
    double focal_px = exif_focal_px(&facts, 4000, 3000);
    if (!(focal_px == 0 || (focal_px >= 800 && focal_px <= 200000))) abort();
    return 0;
}
