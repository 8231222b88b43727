/* The container, the headers of its streams, and EXIF. The pixels are decoded by libde265 and dav1d, which
 * are not built for fuzzing: a stream of a few hundred bytes may take them seconds, and they forget memory.
 */
#include "fuzz.h"
#include "io/heif_stream.h"

/* Of AVIF files that are broken inside, libdav1d keeps a few bytes and libheif a picture's head, 256 bytes
 * that it makes in heif_decode_image and gives to nobody. The stack ends at operator new, so all of C++ is
 * left out: what our own code allocates is still seen, and io_photo sees handles that are not released. */
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
