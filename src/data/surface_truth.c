/* A person's surface in a pose: made from triangles, written, and read with full checks. */
#include "data/surface_truth.h"

#include <math.h>
#include <string.h>

#include "base/path.h"
#include "data/dataset.h"

enum { NEAR = 24576, FAR = 4096, POINTS = NEAR + FAR, PLACES = 20000, ITEMS = 7 };
static const double near_sd_m = 0.05, cube_m = 2.6;
static const float beyond_cells = 2.5f; /* the distance from a place at which its outside is tested */

void surface_truth_free(surface_truth *t) {
    mem_free(t->vertex);
    mem_free(t->triangle);
    mem_free(t->place);
    mem_free(t->normal);
    mem_free(t->color);
    mem_free(t->point);
    mem_free(t->inside);
    *t = (surface_truth){0};
}

/* ---- made ---- */
static sherf_status mesh_join(context *c, const surface_source *from, surface_truth *t) {
    for (int i = 0; i < from->meshes; i++) {
        t->vertices += from->drawn[i].vertices;
        t->triangles += from->drawn[i].triangles;
    }
    t->vertex = mem_alloc(c, (size_t)t->vertices, 3 * sizeof *t->vertex);
    t->triangle = mem_alloc(c, (size_t)t->triangles, 3 * sizeof *t->triangle);
    if (!t->vertex || !t->triangle) return SHERF_NO_MEMORY;
    size_t v = 0, n = 0;
    for (int i = 0; i < from->meshes; i++) {
        const solid_mesh *mesh = &from->drawn[i];
        memcpy(t->vertex + 3 * v, mesh->vertex, 3 * (size_t)mesh->vertices * sizeof *mesh->vertex);
        for (int64_t k = 0; k < 3 * mesh->triangles; k++) t->triangle[n++] = mesh->triangle[k] + (uint32_t)v;
        v += (size_t)mesh->vertices;
    }
    return SHERF_OK;
}

/* The outer side of a place: 1 its front, -1 its back, 0 neither. */
static int open_side(const solid_grid *g, const solid_point *p) {
    for (int side = 1; side >= -1; side -= 2) {
        float out[3];
        for (int k = 0; k < 3; k++)
            out[k] = p->position[k] + (float)side * beyond_cells * g->cell_m * p->normal[k];
        if (solid_at(g, out) == SOLID_OUTSIDE) return side;
    }
    return 0;
}

/* The visible ones among `count` candidates, with their colours. */
static sherf_status places_take(context *c, const surface_source *from, const solid_grid *g,
                                const solid_point *candidate, int64_t count, surface_truth *t) {
    t->place = mem_alloc(c, (size_t)count + 1, 3 * sizeof *t->place);
    t->normal = mem_alloc(c, (size_t)count + 1, 3 * sizeof *t->normal);
    t->color = mem_alloc(c, (size_t)count + 1, 3);
    if (!t->place || !t->normal || !t->color) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < count; i++) {
        const solid_point *p = &candidate[i];
        const size_t at = 3 * (size_t)t->places;
        const int side = open_side(g, p);
        if (!side || !from->color(from->user, p, side < 0, t->color + at)) continue;
        for (int k = 0; k < 3; k++) {
            t->place[at + (size_t)k] = p->position[k];
            t->normal[at + (size_t)k] = (float)side * p->normal[k];
        }
        t->places++;
    }
    return t->places ? SHERF_OK : failure(c, SHERF_BAD_ARGUMENT, "nothing of a surface is seen");
}

static sherf_status points_draw(context *c, const surface_source *from, const solid_grid *g,
                                const solid_point *round, int64_t count, surface_truth *t) {
    const uint64_t key = random_key(from->key, "surface.points", 0);
    int64_t inside = 0;
    t->points = POINTS;
    t->point = mem_alloc(c, POINTS, 3 * sizeof *t->point);
    t->inside = mem_alloc(c, POINTS, 1);
    if (!t->point || !t->inside) return SHERF_NO_MEMORY;
    for (int64_t i = 0; i < POINTS; i++) {
        float *p = t->point + 3 * i;
        for (int k = 0; k < 3; k++) {
            const uint64_t n = 3 * (uint64_t)i + (uint64_t)k;
            const double middle = (double)g->min[k] + 0.5 * g->size[k] * (double)g->cell_m;
            p[k] = i < NEAR
                       ? (float)((double)round[i % count].position[k] + near_sd_m * random_normal(key, n))
                       : (float)(middle + cube_m * (random_uniform(key, 2 * n) - 0.5));
        }
        inside += t->inside[i] = solid_contains(g, p);
    }
    return inside ? SHERF_OK : failure(c, SHERF_BAD_ARGUMENT, "nothing is inside of a surface");
}

sherf_status surface_truth_make(context *c, const surface_source *from, surface_truth *out) {
    solid_grid g = {0};
    int64_t found = 0;
    *out = (surface_truth){0};
    solid_point *candidate = mem_alloc(c, PLACES, sizeof *candidate);
    sherf_status status = candidate ? mesh_join(c, from, out) : SHERF_NO_MEMORY;
    if (status == SHERF_OK)
        status = solid_grid_create(c, from->meshes, from->walls, from->cell_m, from->seal, &g);
    if (status == SHERF_OK)
        status = solid_points(c, &g, from->meshes, from->drawn, from->key, PLACES, candidate, &found);
    if (status == SHERF_OK) status = places_take(c, from, &g, candidate, found, out);
    if (status == SHERF_OK) status = points_draw(c, from, &g, candidate, found, out);
    solid_grid_free(&g);
    mem_free(candidate);
    if (status != SHERF_OK) surface_truth_free(out);
    return status;
}

/* ---- files ---- */
enum { VERTICES, TRIANGLES, AT_PLACES, NORMALS, COLORS, AT_POINTS, INSIDE };
static const struct {
    const char *name;
    dtype type;
    int width;
    unsigned part;
} layout[ITEMS] = {{"vertices", T_F32, 3, TRUTH_MESH},  {"triangles", T_I32, 3, TRUTH_MESH},
                   {"places", T_F32, 3, TRUTH_SAMPLES}, {"normals", T_F32, 3, TRUTH_SAMPLES},
                   {"colors", T_U8, 3, TRUTH_SAMPLES},  {"points", T_F32, 3, TRUTH_SAMPLES},
                   {"inside", T_U8, 1, TRUTH_SAMPLES}};

sherf_status surface_truth_write(context *c, const surface_truth *t, const char *path) {
    static const safetensor_metadata metadata[] = {SAFETENSORS_CHECKSUM, {"format", "sherf-surface"}};
    const int64_t rows[ITEMS] = {t->vertices, t->triangles, t->places, t->places,
                                 t->places,   t->points,    t->points};
    const void *const data[ITEMS] = {t->vertex, t->triangle, t->place, t->normal,
                                     t->color,  t->point,    t->inside};
    safetensor_item item[ITEMS];
    for (int i = 0; i < ITEMS; i++)
        item[i] = (safetensor_item){
            layout[i].name, layout[i].type, layout[i].width > 1 ? 2 : 1, {rows[i], layout[i].width}, data[i]};
    return safetensors_write(c, path, ITEMS, item, COUNT_OF(metadata), metadata);
}

/* A copy of one of its tensors; NULL, and the error. */
static void *item_read(context *c, const safetensors *s, int i, int64_t *rows, sherf_status *status) {
    enum { ROWS_MAX = 1 << 24 };
    const safetensor *x = safetensors_find(s, layout[i].name);
    const size_t size = dtype_size(layout[i].type);
    if (*status != SHERF_OK) return NULL;
    if (!x || x->type != layout[i].type || x->rank != (layout[i].width > 1 ? 2 : 1) ||
        (x->rank == 2 && x->dim[1] != layout[i].width) || x->dim[0] < 1 || x->dim[0] > ROWS_MAX ||
        (*rows && x->dim[0] != *rows)) {
        *status = failure(c, SHERF_BAD_FILE, "tensor %s is missing or of the wrong shape", layout[i].name);
        return NULL;
    }
    *rows = x->dim[0];
    const size_t bytes = (size_t)*rows * (size_t)layout[i].width * size;
    void *copy = mem_alloc(c, bytes, 1);
    if (!copy) {
        *status = SHERF_NO_MEMORY;
        return NULL;
    }
    memcpy(copy, x->data, bytes);
    for (size_t k = 0; layout[i].type == T_F32 && k < bytes / size; k++)
        if (!isfinite(((float *)copy)[k]))
            *status = failure(c, SHERF_BAD_FILE, "tensor %s: a value is not finite", layout[i].name);
    return copy;
}

static sherf_status check(context *c, const surface_truth *t) {
    int64_t inside = 0;
    for (int64_t i = 0; t->triangle && i < 3 * t->triangles; i++)
        if (t->triangle[i] >= t->vertices)
            return failure(c, SHERF_BAD_FILE, "a triangle has a corner that is not there");
    for (int64_t i = 0; t->inside && i < t->points; i++) {
        if (t->inside[i] > 1) return failure(c, SHERF_BAD_FILE, "inside: neither 0 nor 1");
        inside += t->inside[i];
    }
    if (!t->inside || (inside && inside < t->points)) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "its points are all %s", inside ? "inside" : "outside");
}

sherf_status surface_truth_read(context *c, const char *path, unsigned parts, surface_truth *t) {
    safetensors *s = NULL;
    *t = (surface_truth){0};
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    if (parts & TRUTH_MESH) {
        t->vertex = item_read(c, s, VERTICES, &t->vertices, &status);
        t->triangle = item_read(c, s, TRIANGLES, &t->triangles, &status);
    }
    if (parts & TRUTH_SAMPLES) {
        t->place = item_read(c, s, AT_PLACES, &t->places, &status);
        t->normal = item_read(c, s, NORMALS, &t->places, &status);
        t->color = item_read(c, s, COLORS, &t->places, &status);
        t->point = item_read(c, s, AT_POINTS, &t->points, &status);
        t->inside = item_read(c, s, INSIDE, &t->points, &status);
    }
    safetensors_free(s);
    if (status == SHERF_OK) status = check(c, t);
    if (status == SHERF_OK) return status;
    surface_truth_free(t);
    return failure_prefix(c, status, "%s", path);
}

sherf_status surface_truth_path(context *c, const char *folder, int pose, char out[PATH_LENGTH]) {
    if (snprintf(out, PATH_LENGTH, "%s/surface/%d.safetensors", folder, pose) < PATH_LENGTH) return SHERF_OK;
    return failure(c, SHERF_BAD_ARGUMENT, "%.200s: path too long", folder);
}

static sherf_status path_of(context *c, const sherf_dataset *d, int person, int pose, char out[PATH_LENGTH]) {
    const person_record *r;
    char folder[PATH_LENGTH];
    sherf_status status = dataset_record(c, d, person, &r);
    if (status == SHERF_OK) status = dataset_path(c, d, person, "", folder);
    if (status != SHERF_OK) return status;
    return surface_truth_path(c, folder, r->number ? r->number[pose] : pose, out);
}

bool surface_truth_is_there(context *c, const sherf_dataset *d, int person, int pose) {
    char path[PATH_LENGTH];
    return path_of(c, d, person, pose, path) == SHERF_OK && path_is_file(path);
}

sherf_status surface_truth_find(context *c, const sherf_dataset *d, int person, int pose,
                                char path[PATH_LENGTH]) {
    const sherf_status status = path_of(c, d, person, pose, path);
    if (status != SHERF_OK || path_is_file(path)) return status;
    return failure(c, SHERF_NO_FILE,
                   "%s: not there: surfaces are wanted, which `sherf synth people --surfaces` adds to "
                   "made people (docs/datasets.md has the files for others)",
                   path);
}

sherf_status surface_truth_load(context *c, const sherf_dataset *d, int person, int pose, unsigned parts,
                                surface_truth *out) {
    char path[PATH_LENGTH];
    *out = (surface_truth){0};
    const sherf_status status = surface_truth_find(c, d, person, pose, path);
    return status == SHERF_OK ? surface_truth_read(c, path, parts, out) : status;
}
