/* OBJ: with a texture, and NAME.mtl and NAME.png next to it; without, with colours after the vertices'
 * coordinates. */
#include <string.h>

#include "base/path.h"
#include "export/export.h"
#include "io/image.h"

/* The path with another ending, and the part after its last slash. */
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
    status = output_print(c, &f, "newmtl person\nKd 1 1 1\nKs 0 0 0\nillum 1\nmap_Kd %s\n", picture);
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}

static sherf_status obj_rows(context *c, output_file *f, const surface *s, const atlas *a, const float *rgb) {
    sherf_status status = SHERF_OK;
    for (int64_t v = 0; v < s->vertices && status == SHERF_OK; v++) {
        const float *p = s->position + 3 * v;
        if (a)
            status = output_print(c, f, "v %.6f %.6f %.6f\n", (double)p[0], (double)p[1], (double)p[2]);
        else
            status = output_print(c, f, "v %.6f %.6f %.6f %.4f %.4f %.4f\n", (double)p[0], (double)p[1],
                                  (double)p[2], (double)rgb[3 * v], (double)rgb[3 * v + 1],
                                  (double)rgb[3 * v + 2]);
    }
    for (int64_t i = 0; a && i < a->corners && status == SHERF_OK; i++)
        status = output_print(c, f, "vt %.6f %.6f\n", (a->uv[2 * i] + 0.5) / a->side_px,
                              1 - (a->uv[2 * i + 1] + 0.5) / a->side_px);
    for (int64_t v = 0; v < s->vertices && status == SHERF_OK; v++)
        status = output_print(c, f, "vn %.4f %.4f %.4f\n", (double)s->normal[3 * v],
                              (double)s->normal[3 * v + 1], (double)s->normal[3 * v + 2]);
    for (int64_t t = 0; t < s->triangles && status == SHERF_OK; t++) {
        long long v[3], u[3];
        for (int k = 0; k < 3; k++) {
            v[k] = (long long)s->triangle[3 * t + k] + 1;
            u[k] = a ? (long long)a->triangle[3 * t + k] + 1 : 0;
        }
        if (a)
            status = output_print(c, f, "f %lld/%lld/%lld %lld/%lld/%lld %lld/%lld/%lld\n", v[0], u[0], v[0],
                                  v[1], u[1], v[1], v[2], u[2], v[2]);
        else
            status = output_print(c, f, "f %lld//%lld %lld//%lld %lld//%lld\n", v[0], v[0], v[1], v[1], v[2],
                                  v[2]);
    }
    return status;
}

static sherf_status obj_write(context *c, const export_job *j) {
    const baked_person *p = j->person;
    const char *path = j->path;
    const atlas *a = p->picture ? &p->atlas : NULL;
    char material[PATH_LENGTH], png[PATH_LENGTH];
    output_file f;
    if (!path_beside(path, ".mtl", material) || !path_beside(path, ".png", png))
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    sherf_status status = output_open(c, path, &f);
    if (status != SHERF_OK) return status;
    status = output_print(c, &f, "# sherf " SHERF_VERSION "\n# axes: %s\n", j->axes);
    if (status == SHERF_OK && a)
        status = output_print(c, &f, "mtllib %s\nusemtl person\n", name_of(material));
    if (status == SHERF_OK) status = obj_rows(c, &f, &p->surface, a, p->rgb);
    /* files that the mesh refers to come first, the mesh last */
    if (status == SHERF_OK && a) status = png_write(c, png, a->side_px, a->side_px, 3, p->picture);
    if (status == SHERF_OK && a) status = material_write(c, material, name_of(png));
    if (status == SHERF_OK) status = output_commit(c, &f);
    output_abort(&f);
    return status;
}

const export_format export_obj = {.name = "obj", .ending = ".obj", .texture = true, .write = obj_write};
