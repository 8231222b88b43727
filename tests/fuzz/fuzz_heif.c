/* Fuzz target: HEIF containers, the headers of their streams, and EXIF. libde265 and dav1d, which decode the
 * pixels, are not built for fuzzing, may take seconds for a stream of a few hundred bytes, and leak memory.
 */
#include "fuzz.h"
#include "io/heif_stream.h"

/* For broken AVIF files, libdav1d leaks a few bytes and libheif a picture's header, 256 bytes allocated in
 * heif_decode_image. The stack ends at operator new, so all of C++ is suppressed: our own code's allocations
 * are still checked, and io_photo checks that handles are released. */
const char *__lsan_default_suppressions(void);
const char *__lsan_default_suppressions(void) {
    return "leak:libdav1d.so\nleak:libstdc++.so\n";
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    size_t live = mem_live();
    image_u8 p;
    heif_sizes sizes;
    if (heif_stream_sizes(c, data, size, &sizes) != SHERF_OK) abort();
    sherf_status status = image_parse(c, data, size, 0, &p);
    if (p.data || (status == SHERF_OK) != (p.width > 0 && p.height > 0)) abort();
    return fuzz_end(c, status, live);
}
