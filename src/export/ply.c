/* PLY: meshes with vertex colours, and 3D Gaussian splats. */
#include <math.h>
#include <string.h>

#include "base/path.h"
#include "export/export.h"
#include "io/image.h"

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

/* ---- a binary mesh with normals and colours ---- */
static sherf_status mesh_write(context *c, const export_job *j) {
    const surface *s = &j->person->surface;
    output_file f;
    sherf_status status = output_open(c, j->path, &f);
    if (status != SHERF_OK) return status;
    status = output_print(c, &f,
                          "ply\nformat binary_little_endian 1.0\ncomment sherf " SHERF_VERSION
                          "\ncomment axes: %s\n"
                          "element vertex %lld\nproperty float x\nproperty float y\nproperty float z\n"
                          "property float nx\nproperty float ny\nproperty float nz\n"
                          "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                          "element face %lld\nproperty list uchar int vertex_indices\nend_header\n",
                          j->axes, (long long)s->vertices, (long long)s->triangles);
    if (status == SHERF_OK) status = ply_rows(c, &f, s, j->person->rgb);
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}

const export_format export_ply = {.name = "ply", .ending = ".ply", .write = mesh_write};

/* ---- splats, as the viewers of 3D Gaussian splatting (Kerbl et al., 2023) expect them ---- */
/* Logarithms of scales, logit of opacity, colours as the constant spherical harmonic, rotation w x y z. */
static sherf_status splats_write(context *c, const export_job *j) {
    const splats *s = &j->person->splats;
    /* colour is 0.5 + the first spherical harmonic's constant times f_dc */
    static const float harmonic = 0.28209479177387814f;
    enum { BATCH = 4096, NUMBERS = 17 };
    output_file f;
    float *rows = mem_alloc(c, BATCH, NUMBERS * sizeof *rows), *to = rows;
    sherf_status status = rows ? output_open(c, j->path, &f) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) {
        mem_free(rows);
        return status;
    }
    status = output_print(c, &f,
                          "ply\nformat binary_little_endian 1.0\ncomment sherf " SHERF_VERSION
                          "\ncomment axes: %s\nelement vertex %lld\n"
                          "property float x\nproperty float y\nproperty float z\n"
                          "property float nx\nproperty float ny\nproperty float nz\n"
                          "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n"
                          "property float opacity\n"
                          "property float scale_0\nproperty float scale_1\nproperty float scale_2\n"
                          "property float rot_0\nproperty float rot_1\nproperty float rot_2\n"
                          "property float rot_3\nend_header\n",
                          j->axes, (long long)s->count);
    for (int64_t i = 0; i < s->count && status == SHERF_OK; i++) {
        const float *n = s->normal + 3 * i;
        memcpy(to, s->position + 3 * i, 3 * sizeof *to);
        memcpy(to + 3, n, 3 * sizeof *to);
        for (int k = 0; k < 3; k++) to[6 + k] = (s->rgb[3 * i + k] - 0.5f) / harmonic;
        to[9] = logf(s->opacity / (1 - s->opacity));
        to[10] = to[11] = logf(s->across_m);
        to[12] = logf(s->along_m);
        splat_rotation(n, to + 13);
        to += NUMBERS;
        if (i % BATCH != BATCH - 1 && i + 1 < s->count) continue;
        status = output_write(c, &f, rows, (size_t)(to - rows) * sizeof *rows);
        to = rows;
    }
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    mem_free(rows);
    return status;
}

const export_format export_splats = {.name = "splats", .splats = true, .write = splats_write};
