/* Fuzz target: videos. FFmpeg's libraries are not instrumented here, so this finds crashes, leaks and endless
 * videos on our side. */
#include "fuzz.h"
#include "io/video_read.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    enum { FRAMES = 30 };
    context *c = fuzz_context();
    size_t live = mem_live();
    const video_read_options o = {.side_px = size % 2 ? 0 : 48, .pixels_max = 1 << 18};
    video_reader *v;
    volatile uint64_t sum = 0;
    sherf_status status = video_read_parse(c, data, size, &o, &v);
    if ((status == SHERF_OK) != (v != NULL)) abort();
    for (int i = 0; v && i < FRAMES && status == SHERF_OK; i++) {
        const image_u8 *p;
        status = video_read_next(c, v, &p, NULL);
        if (status != SHERF_OK || !p) break;
        if (p->width != video_read_information(v)->width || p->channels != 3) abort();
        sum += fuzz_sum(p->data, (size_t)p->width * (size_t)p->height * 3);
    }
    (void)sum;
    video_read_close(v);
    return fuzz_end(c, status, live);
}
