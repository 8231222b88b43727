/* Meshes and splats as PLY, meshes as OBJ. All files appear whole or not at all. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "export/export.h"
#include "io/image.h"

#define AXES_TEXT "+Y up, the person faces +Z in rest pose, metres"

/* A PLY file's header, from `text` on. */
static sherf_status header_write(context *c, output_file *f, const char *format, ...) PRINTF_LIKE(3, 4);
static sherf_status header_write(context *c, output_file *f, const char *format, ...) {
    char text[4096];
    va_list args;
    va_start(args, format);
    int n = vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return output_write(c, f, text, (size_t)n);
}

static uint8_t *put(uint8_t *to, const void *from, size_t bytes) {
    memcpy(to, from, bytes); /* little endian, as the processors this runs on */
    return to + bytes;
}

static sherf_status ply_rows(context *c, output_file *f, const surface *s, const float *rgb) {
    enum { BATCH = 4096, VERTEX_BYTES = 27, FACE_BYTES = 13 };
    uint8_t *rows = mem_alloc(c, BATCH, VERTEX_BYTES), *to = rows;
    sherf_status status = rows ? SHERF_OK : SHERF_NO_MEMORY;
    for (int64_t v = 0; v < s->vertices && status == SHERF_OK; v++) {
        to = put(to, s->position + 3 * v, 3 * sizeof(float));
        to = put(to, s->normal + 3 * v, 3 * sizeof(float));
        for (int k = 0; k < 3; k++) *to++ = float_to_u8(rgb[3 * v + k]);
        if (v % BATCH != BATCH - 1 && v + 1 < s->vertices) continue;
        status = output_write(c, f, rows, (size_t)(to - rows));
        to = rows;
    }
    for (int64_t t = 0; t < s->triangles && status == SHERF_OK; t++) {
        *to++ = 3;
        to = put(to, s->triangle + 3 * t, 3 * sizeof(uint32_t));
        if (t % BATCH != BATCH - 1 && t + 1 < s->triangles) continue;
        status = output_write(c, f, rows, (size_t)(to - rows));
        to = rows;
    }
    mem_free(rows);
    return status;
}

sherf_status ply_mesh_write(context *c, const char *path, const surface *s, const float *rgb) {
    output_file f;
    sherf_status status = output_open(c, path, &f);
    if (status != SHERF_OK) return status;
    status = header_write(c, &f,
                          "ply\nformat binary_little_endian 1.0\ncomment sherf " SHERF_VERSION
                          "\ncomment axes: " AXES_TEXT "\n"
                          "element vertex %lld\nproperty float x\nproperty float y\nproperty float z\n"
                          "property float nx\nproperty float ny\nproperty float nz\n"
                          "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                          "element face %lld\nproperty list uchar int vertex_indices\nend_header\n",
                          (long long)s->vertices, (long long)s->triangles);
    if (status == SHERF_OK) status = ply_rows(c, &f, s, rgb);
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}
