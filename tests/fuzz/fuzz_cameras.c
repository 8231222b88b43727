/* Fuzz target: camera files, as JSON in all its layouts and everything else that document_read accepts. The
 * first byte chooses the reader: with a picture's size, without, or for a data set's cameras.json. */
#include <math.h>

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

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static const int picture[2] = {640, 480};
    context *c = fuzz_context();
    if (!size) return 0;
    const int way = data[0] % 4;
    const char *path = fuzz_file("cameras.json", data + 1, size - 1);
    const size_t live = mem_live();
    parsed_camera *camera = NULL;
    int count = 0;
    sherf_status status =
        way < 2 ? cameras_read(c, path, way ? picture : NULL, &camera, &count) : of_data_set(c, way - 2);
    if (way < 2 && (status == SHERF_OK) != (camera != NULL && count > 0)) abort();
    for (int i = 0; i < count; i++) camera_use(c, &camera[i]);
    mem_free(camera);
    return fuzz_end(c, status, live);
}
