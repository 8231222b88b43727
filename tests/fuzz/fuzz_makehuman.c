/* Fuzz target: MakeHuman's package. One of its files, chosen by the first byte, is arbitrary and the others
 * are valid. If the package opens, bodies are shaped with it. */
#include "fuzz_folder.h"

#include "../support/makehuman_small.h"
#include "base/path.h"
#include "synth/body/makehuman.h"

static void package_make(context *c) {
    static bool made;
    char path[256];
    if (made) return;
    for (size_t i = 0; i < COUNT_OF(makehuman_folders); i++) {
        snprintf(path, sizeof path, "%s/%s", fuzz_folder(), makehuman_folders[i]);
        if (folder_make(c, path) != SHERF_OK) abort();
    }
    for (int i = 0; i < FILES; i++)
        if (!makehuman_small_restore(fuzz_folder(), i)) abort();
    made = true;
}

/* Shapes people at every corner of the macro parameters and visits every point of the rig. */
static void use(context *c, const makehuman *data) {
    const makehuman_macro corner = {
        .sex = 1, .age_years = 90, .weight = 1, .muscle = 1, .height = 1, .asian = 1};
    float *vertices = malloc(sizeof *vertices * 3 * (size_t)data->vertices);
    double *points = malloc(sizeof *points * 3 * (size_t)data->points);
    if (!vertices || !points || makehuman_shape(c, data, &corner, 0, NULL, vertices) != SHERF_OK) abort();
    makehuman_points(data, vertices, points);
    for (int i = 0; i < data->bones; i++)
        if (makehuman_bone_find(data, data->bone[i].name) < 0 || data->bone[i].parent >= i) abort();
    free(vertices);
    free(points);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    context *c = fuzz_context();
    makehuman *loaded = NULL;
    if (!size) return 0;
    package_make(c);
    const int which = data[0] % FILES;
    if (!makehuman_small_write(fuzz_folder(), which, data + 1, size - 1)) abort();
    size_t live = mem_live();
    sherf_status status = makehuman_open(c, fuzz_folder(), &loaded);
    if ((status == SHERF_OK) != (loaded != NULL)) abort();
    if (loaded) use(c, loaded);
    makehuman_close(loaded);
    if (!makehuman_small_restore(fuzz_folder(), which)) abort();
    return fuzz_end(c, status, live);
}
