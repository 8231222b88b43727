/* Samples clothes and skin with the colours that pictures show, points inside and outside, and the triangles.
 */
#include "synth/people/people_surface.h"

#include <math.h>
#include <stdio.h>

#include "data/thuman_write.h"
#include "io/value.h"

static const float cell_m = 0.004f; /* docs/rivals.md says which sizes leak */
enum { SEAL = 1 };

typedef struct {
    const trace_scene *scene;
    const people_surface *surface;
} lit;

static bool color(void *user, const solid_point *p, bool behind, uint8_t rgb[3]) {
    const lit *l = user;
    return trace_face_color(l->scene, l->surface->mesh[p->mesh], (uint32_t)p->triangle, p->weight, behind,
                            rgb);
}

sherf_status people_surface_write(context *c, const studio *s, const dressed *d, const trace_scene *scene,
                                  float *const *position, uint64_t key, const char *path) {
    people_surface surface;
    surface_truth truth;
    people_surface_of(s, d, position, &surface);
    lit l = {scene, &surface};
    const surface_source from = {surface.meshes, surface.drawn, surface.walls, cell_m, SEAL, key, color, &l};
    sherf_status status = surface_truth_make(c, &from, &truth);
    if (status == SHERF_OK) status = surface_truth_write(c, &truth, path);
    surface_truth_free(&truth);
    return status;
}

sherf_status people_surface_same(context *c, const char *folder, int pose, int vertices,
                                 const float *vertices_world) {
    static const double apart_m = 1e-4;
    const size_t count = 3 * (size_t)vertices;
    char name[64], path[PATH_LENGTH];
    document *file = NULL;
    snprintf(name, sizeof name, "new_vertices/%d.npy", pose);
    double *there = mem_alloc(c, count, sizeof *there);
    sherf_status status = there ? thuman_path(c, path, folder, name) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = npy_read(c, path, &file);
    if (status == SHERF_OK) status = value_doubles(c, file->root, "the vertices", count, there);
    for (size_t i = 0; status == SHERF_OK && i < count; i++)
        if (!(fabs(there[i] - (double)vertices_world[i]) < apart_m))
            status =
                failure(c, SHERF_MISMATCH,
                        "%s: the person stands otherwise than this version would draw it, so its surface "
                        "is not known: choose another folder",
                        path);
    document_free(file);
    mem_free(there);
    return status;
}
