/* Meshes and splats as PLY, meshes as OBJ. All files appear whole or not at all. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "export/mesh_file.h"
#include "io/image.h"

static sherf_status text_write(context *c, output_file *f, const char *format, ...) PRINTF_LIKE(3, 4);
static sherf_status text_write(context *c, output_file *f, const char *format, ...) {
    char text[4096];
    va_list args;
    va_start(args, format);
    int n = vsnprintf(text, sizeof text, format, args);
    va_end(args);
    if (n < 0 || (size_t)n >= sizeof text)
        return failure(c, SHERF_BAD_ARGUMENT, "export: a line is too long");
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

sherf_status ply_mesh_write(context *c, const char *path, const char *axes, const surface *s,
                            const float *rgb) {
    output_file f;
    sherf_status status = output_open(c, path, &f);
    if (status != SHERF_OK) return status;
    status =
        text_write(c, &f,
                   "ply\nformat binary_little_endian 1.0\ncomment sherf " SHERF_VERSION "\ncomment axes: %s\n"
                   "element vertex %lld\nproperty float x\nproperty float y\nproperty float z\n"
                   "property float nx\nproperty float ny\nproperty float nz\n"
                   "property uchar red\nproperty uchar green\nproperty uchar blue\n"
                   "element face %lld\nproperty list uchar int vertex_indices\nend_header\n",
                   axes, (long long)s->vertices, (long long)s->triangles);
    if (status == SHERF_OK) status = ply_rows(c, &f, s, rgb);
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}

/* ---- splats ---- */
sherf_status ply_splats_write(context *c, const char *path, const char *axes, const splats *s) {
    /* colour is 0.5 + the first spherical harmonic's constant times f_dc */
    static const float harmonic = 0.28209479177387814f;
    enum { BATCH = 4096, NUMBERS = 17 };
    output_file f;
    float *rows = mem_alloc(c, BATCH, NUMBERS * sizeof *rows), *to = rows;
    sherf_status status = rows ? output_open(c, path, &f) : SHERF_NO_MEMORY;
    if (status != SHERF_OK) {
        mem_free(rows);
        return status;
    }
    status = text_write(c, &f,
                        "ply\nformat binary_little_endian 1.0\ncomment sherf " SHERF_VERSION
                        "\ncomment axes: %s\nelement vertex %lld\n"
                        "property float x\nproperty float y\nproperty float z\n"
                        "property float nx\nproperty float ny\nproperty float nz\n"
                        "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n"
                        "property float opacity\n"
                        "property float scale_0\nproperty float scale_1\nproperty float scale_2\n"
                        "property float rot_0\nproperty float rot_1\nproperty float rot_2\n"
                        "property float rot_3\nend_header\n",
                        axes, (long long)s->count);
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

/* ---- OBJ ---- */
/* The path with another ending, and what follows its last slash. */
static bool path_beside(const char *path, const char *end, char out[PATH_LENGTH]) {
    size_t stem = strlen(path) - (path_ends(path, ".obj") ? 4 : 0);
    return snprintf(out, PATH_LENGTH, "%.*s%s", (int)stem, path, end) < PATH_LENGTH;
}

static const char *name_of(const char *path) {
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static sherf_status material_write(context *c, const char *path, const char *picture) {
    output_file f;
    sherf_status status = output_open(c, path, &f);
    if (status != SHERF_OK) return status;
    status = text_write(c, &f, "newmtl person\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd %s\n", picture);
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}

static sherf_status obj_rows(context *c, output_file *f, const surface *s, const atlas *a, const float *rgb) {
    sherf_status status = SHERF_OK;
    for (int64_t v = 0; v < s->vertices && status == SHERF_OK; v++) {
        const float *p = s->position + 3 * v;
        if (a)
            status = text_write(c, f, "v %.6f %.6f %.6f\n", (double)p[0], (double)p[1], (double)p[2]);
        else
            status =
                text_write(c, f, "v %.6f %.6f %.6f %.4f %.4f %.4f\n", (double)p[0], (double)p[1],
                           (double)p[2], (double)rgb[3 * v], (double)rgb[3 * v + 1], (double)rgb[3 * v + 2]);
    }
    for (int64_t i = 0; a && i < a->corners && status == SHERF_OK; i++)
        status = text_write(c, f, "vt %.6f %.6f\n", (a->uv[2 * i] + 0.5) / a->side_px,
                            1 - (a->uv[2 * i + 1] + 0.5) / a->side_px);
    for (int64_t v = 0; v < s->vertices && status == SHERF_OK; v++)
        status = text_write(c, f, "vn %.4f %.4f %.4f\n", (double)s->normal[3 * v],
                            (double)s->normal[3 * v + 1], (double)s->normal[3 * v + 2]);
    for (int64_t t = 0; t < s->triangles && status == SHERF_OK; t++) {
        long long v[3], u[3];
        for (int k = 0; k < 3; k++) {
            v[k] = (long long)s->triangle[3 * t + k] + 1;
            u[k] = a ? (long long)a->triangle[3 * t + k] + 1 : 0;
        }
        if (a)
            status = text_write(c, f, "f %lld/%lld/%lld %lld/%lld/%lld %lld/%lld/%lld\n", v[0], u[0], v[0],
                                v[1], u[1], v[1], v[2], u[2], v[2]);
        else
            status =
                text_write(c, f, "f %lld//%lld %lld//%lld %lld//%lld\n", v[0], v[0], v[1], v[1], v[2], v[2]);
    }
    return status;
}

sherf_status obj_write(context *c, const char *path, const char *axes, const surface *s, const atlas *a,
                       const uint8_t *picture, const float *rgb) {
    char material[PATH_LENGTH], png[PATH_LENGTH];
    output_file f;
    if (!path_beside(path, ".mtl", material) || !path_beside(path, ".png", png))
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    sherf_status status = output_open(c, path, &f);
    if (status != SHERF_OK) return status;
    status = text_write(c, &f, "# sherf " SHERF_VERSION "\n# axes: %s\n", axes);
    if (status == SHERF_OK && a) status = text_write(c, &f, "mtllib %s\nusemtl person\n", name_of(material));
    if (status == SHERF_OK) status = obj_rows(c, &f, s, a, rgb);
    /* what the mesh refers to comes first, the mesh last */
    if (status == SHERF_OK && a) status = png_write(c, png, a->side_px, a->side_px, 3, picture);
    if (status == SHERF_OK && a) status = material_write(c, material, name_of(png));
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}
