/* sherf_export: the way from an avatar to a file. */
#include <math.h>
#include <string.h>

#include "base/path.h"
#include "export/export.h"

typedef struct {
    const sherf_avatar *a;
    const body_model *m;
    sherf_export_options options;
    sherf_exported report;
    field_grid density;
    surface surface;
    float *rgb; /* V x 3 */
} export_job;

static sherf_status options_check(context *c, const sherf_export_options *given, const char *path,
                                  sherf_export_options *o) {
    *o = given ? *given : (sherf_export_options){0};
    if (!o->resolution) o->resolution = 256;
    if (!(o->level >= 0 && o->level <= 1e6))
        return failure(c, SHERF_BAD_ARGUMENT, "level %g: must be 0 to 1000000 per metre", o->level);
    if (!(o->islands >= 0 && o->islands <= 1))
        return failure(c, SHERF_BAD_ARGUMENT, "islands %g: must be 0 to 1", o->islands);
    if (o->islands == 0) o->islands = 0.02;
    if (!path_ends(path, ".ply"))
        return failure(c, SHERF_BAD_ARGUMENT, "%s: exported files end in .ply", path);
    return SHERF_OK;
}

/* Density to a clean surface in canonical space. */
static sherf_status surface_make(context *c, export_job *j) {
    sherf_status status = field_density(c, j->a, j->m, j->options.resolution, &j->density);
    float level = (float)j->options.level;
    if (status == SHERF_OK && !(level > 0)) status = field_level(c, &j->density, &level);
    j->report.level = level;
    if (status == SHERF_OK) status = field_solidify(c, &j->density, level);
    if (status == SHERF_OK) status = cubes_surface(c, &j->density, level, &j->surface);
    if (status == SHERF_OK)
        status = surface_keep_large(c, &j->surface, j->options.islands, &j->report.islands);
    if (status == SHERF_OK && !j->surface.triangles)
        status = failure(c, SHERF_BAD_ARGUMENT, "level %g: the avatar is nowhere that dense", (double)level);
    if (status == SHERF_OK) status = surface_normals(c, &j->surface, &j->density);
    return status;
}

static sherf_status export_run(context *c, export_job *j, const char *path) {
    sherf_status status = surface_make(c, j);
    if (status != SHERF_OK) return status;
    const surface *s = &j->surface;
    if (!(j->rgb = mem_alloc(c, (size_t)s->vertices, 3 * sizeof *j->rgb))) return SHERF_NO_MEMORY;
    status = bake_colors(c, j->a, j->m, s->vertices, s->position, s->normal, j->rgb);
    j->report.vertices = s->vertices;
    j->report.triangles = s->triangles;
    return status == SHERF_OK ? ply_mesh_write(c, path, s, j->rgb) : status;
}

sherf_status sherf_export(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                          const sherf_export_options *options, const char *path, sherf_exported *out) {
    export_job j = {.a = avatar, .m = body};
    if (out) *out = (sherf_exported){0};
    sherf_status status = options_check(c, options, path, &j.options);
    if (status == SHERF_OK) status = export_run(c, &j, path);
    field_grid_free(&j.density);
    surface_free(&j.surface);
    mem_free(j.rgb);
    if (status == SHERF_OK && out) *out = j.report;
    return status;
}
