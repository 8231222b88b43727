/* Fuzz target: an observation's JSON beside a valid picture and mask: i.png and m.png, 32 x 32, with the mask
 * in the middle. The JSON, o.json, may name itself as its camera or body file. */
#include <string.h>

#include "data/data.h"
#include "fuzz_folder.h"

enum { SIDE = 32 };

static void pictures_make(context *c) {
    char path[128];
    float pixel[SIDE * SIDE * 3], mask[SIDE * SIDE];
    for (int i = 0; i < SIDE * SIDE; i++) {
        mask[i] = i / SIDE > 4 && i / SIDE < 28 && i % SIDE > 10 && i % SIDE < 22;
        for (int k = 0; k < 3; k++) pixel[3 * i + k] = (float)(i % (7 + k)) / 10;
    }
    const sherf_image picture = {SIDE, SIDE, 3, pixel}, person = {SIDE, SIDE, 1, mask};
    snprintf(path, sizeof path, "%s/i.png", fuzz_folder());
    if (sherf_image_write(c, path, &picture) != SHERF_OK) abort();
    snprintf(path, sizeof path, "%s/m.png", fuzz_folder());
    if (sherf_image_write(c, path, &person) != SHERF_OK) abort();
}

/* Paths may lead anywhere in a user's own file; this target only reads files beside the JSON. */
static bool leads_away(const uint8_t *data, size_t size) {
    return memchr(data, '/', size) || memchr(data, '\\', size);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static bool made;
    context *c = fuzz_context();
    if (!made) pictures_make(c);
    made = true;
    if (leads_away(data, size)) return 0;
    const char *path = fuzz_file("o.json", data, size);
    const size_t live = mem_live();
    sherf_observation *o = NULL;
    sherf_status status = sherf_observation_load(c, path, &o);
    if ((status == SHERF_OK) != (o != NULL)) abort();
    if (o) {
        const sherf_image *image = sherf_observation_image(o);
        volatile uint64_t sum =
            fuzz_sum(image->data, sizeof(float) * 3 * (size_t)image->width * (size_t)image->height);
        (void)sum;
        if (observation_check(c, o) != SHERF_OK) abort();
    }
    sherf_observation_free(o);
    return fuzz_end(c, status, live);
}
