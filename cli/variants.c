/* A sheet of an avatar's variants. */
#include "variants.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { VIEWS = 3, WIDE = 192, HIGH = 288, COLUMNS = 8 };

static int cameras_behind(session *s, const sherf_avatar *a, const sherf_body *body,
                          sherf_camera camera[VIEWS]) {
    static const double azimuth_deg[VIEWS] = {180, 125, 235};
    int status = EXIT_DONE;
    for (int v = 0; v < VIEWS && !status; v++) {
        const sherf_orbit_options o = {
            .azimuth_rad = azimuth_deg[v] * acos(-1.) / 180, .width_px = WIDE, .height_px = HIGH};
        status = session_status(
            s, sherf_cameras_orbit(s->context, body, sherf_avatar_pose(a), 1, &o, 1, &camera[v]));
    }
    return status;
}

static void put(const sherf_frame *frame, sherf_image *sheet, int column, int row) {
    for (int y = 0; y < HIGH; y++)
        memcpy(sheet->data + 3 * ((size_t)(row * HIGH + y) * (size_t)sheet->width + (size_t)(column * WIDE)),
               frame->color.data + 3 * (size_t)y * WIDE, 3 * WIDE * sizeof(float));
}

static int draw(session *s, sherf_avatar *a, const sherf_body *body, int count, sherf_image *sheet) {
    sherf_camera camera[VIEWS];
    sherf_frame frame = {0};
    int status = cameras_behind(s, a, body, camera);
    for (int i = 0; i <= count && !status; i++) {
        status = session_status(s, sherf_avatar_choose(s->context, a, (uint64_t)i));
        for (int v = 0; v < VIEWS && !status; v++) {
            status = session_status(
                s, sherf_render(s->context, a, body, sherf_avatar_pose(a), &camera[v], NULL, &frame));
            if (!status) put(&frame, sheet, i % COLUMNS, i / COLUMNS * VIEWS + v);
        }
        session_progress("variants", i + 1, count + 1);
    }
    sherf_frame_free(&frame);
    return status;
}

int variants_sheet(session *s, sherf_avatar *avatar, const sherf_body *body, int count, const char *path) {
    const int columns = count < COLUMNS ? count + 1 : COLUMNS, lines = count / COLUMNS + 1;
    const uint64_t own = sherf_avatar_variant(avatar);
    sherf_image sheet = {columns * WIDE, lines * VIEWS * HIGH, 3, NULL};
    sheet.data = calloc((size_t)sheet.width * (size_t)sheet.height, 3 * sizeof *sheet.data);
    if (!sheet.data) return session_failure("no memory for a sheet of %d variants", count);
    int status = draw(s, avatar, body, count, &sheet);
    if (!status) status = session_status(s, sherf_avatar_choose(s->context, avatar, own));
    if (!status) status = session_status(s, sherf_image_write(s->context, path, &sheet));
    free(sheet.data);
    return status;
}
