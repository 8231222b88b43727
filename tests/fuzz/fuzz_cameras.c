/* Fuzz target: camera files, as JSON in all its layouts and everything else that document_read accepts. The
 * first byte chooses the reader: with a picture's size, without, for a data set's cameras.json, or for the
 * pairs of files that EasyMocap and COLMAP write, divided by a byte 1. */
#include <math.h>
#include <string.h>

#include "data/dataset.h"
#include "fuzz_folder.h"

static void camera_use(context *c, const parsed_camera *camera) {
    sherf_camera out;
    if (parsed_camera_check(c, camera) != SHERF_OK || parsed_camera_placed(c, camera) != SHERF_OK) abort();
    for (int i = 0; i < DISTORTION_MAX; i++)
        if (!isfinite(camera->D[i])) abort();
    if (camera->width < 0 || camera->height < 0) abort();
    parsed_camera_to(camera, 640, 480, 320, 240, &out);
}

static sherf_status of_data_set(context *c, int kind) {
    static const char *const name[] = {"camera", "kinect_color_"};
    static const int digits[] = {4, 3};
    person_record r = {0};
    sherf_status status = cameras_json_read(c, fuzz_folder(), name[kind], digits[kind], &r);
    for (int i = 0; i < r.views && !status; i++) camera_use(c, &r.camera[i]);
    mem_free(r.camera);
    return status;
}

/* Writes the data before and after the first byte 1 into two files; returns the path of the second. */
static const char *pair_of(const char *first, const char *second, const uint8_t *data, size_t size) {
    const uint8_t *cut = memchr(data, 1, size);
    const size_t n = cut ? (size_t)(cut - data) : size;
    fuzz_file(first, data, n);
    return fuzz_file(second, cut ? cut + 1 : data, cut ? size - n - 1 : 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const int picture[2] = {640, 480};
    context *c = fuzz_context();
    if (!size) return 0;
    const int way = data[0] % 6;
    const char *path = way == 4   ? pair_of("intri.yml", "extri.yml", data + 1, size - 1)
                       : way == 5 ? pair_of("cameras.txt", "images.txt", data + 1, size - 1)
                                  : fuzz_file("cameras.json", data + 1, size - 1);
    const bool whole = way < 2 || way > 3;
    const size_t live = mem_live();
    parsed_camera *camera = NULL;
    int count = 0;
    sherf_status status =
        whole ? cameras_read(c, path, way == 1 ? picture : NULL, &camera, &count) : of_data_set(c, way - 2);
    if (whole && (status == SHERF_OK) != (camera != NULL && count > 0)) abort();
    for (int i = 0; i < count; i++) camera_use(c, &camera[i]);
    mem_free(camera);
    return fuzz_end(c, status, live);
}
