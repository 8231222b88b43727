/* From an avatar to a posed surface with its colours, or to splats. */
#include "baked/person.h"

#include "baked/texels.h"

#include <math.h>
#include <string.h>

typedef struct {
    const sherf_avatar *a;
    const body_model *body;
    const baked_options *o;
    baked_person *out;
    double since_s;
} bake_steps;

static void lap(bake_steps *j, int part) {
    double now_s = time_seconds();
    j->out->report.seconds[part] += now_s - j->since_s;
    j->since_s = now_s;
}

/* Density to a clean surface in canonical space. */
static sherf_status surface_make(context *c, bake_steps *j) {
    const baked_options *o = j->o;
    baked_person *p = j->out;
    cubes_grid density = {0};
    float level = (float)o->level;
    sherf_status status = field_density(c, j->a, j->body, o->resolution, &density);
    if (status == SHERF_OK && !(level > 0)) {
        status = field_level(c, &density, &level);
        if (status == SHERF_OK) status = field_level_places(c, &density, level);
    }
    p->report.level = level;
    if (status == SHERF_OK) status = field_solidify(c, &density, level);
    if (status == SHERF_OK) status = cubes_surface(c, &density, level, &p->surface);
    if (status == SHERF_OK) status = surface_keep_large(c, &p->surface, o->islands, &p->report.islands);
    if (status == SHERF_OK && !p->surface.triangles)
        status = failure(c, SHERF_BAD_ARGUMENT, "level %g: the avatar is nowhere that dense", (double)level);
    lap(j, 0);
    if (status == SHERF_OK && o->triangles) status = surface_reduce(c, &p->surface, o->triangles);
    if (status == SHERF_OK) status = surface_normals(c, &p->surface, &density);
    cubes_grid_free(&density);
    p->report.vertices = p->surface.vertices;
    p->report.triangles = p->surface.triangles;
    lap(j, 1);
    return status;
}

/* The skin, and the surface's vertices in the world of the posed body. */
static sherf_status surface_pose(context *c, bake_steps *j, surface *posed) {
    baked_person *p = j->out;
    const surface *s = &p->surface;
    const size_t V = (size_t)s->vertices;
    sherf_pose pose;
    sherf_pose_identity(&pose);
    memcpy(pose.shapes, sherf_avatar_pose(j->a)->shapes, sizeof pose.shapes);
    if (j->o->pose) pose = *j->o->pose;
    posed->position = mem_alloc(c, V, 3 * sizeof *posed->position);
    posed->normal = mem_alloc(c, V, 3 * sizeof *posed->normal);
    sherf_status status = posed->position && posed->normal ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = skin_make(c, j->body, s->vertices, s->position, &p->skin);
    if (status == SHERF_OK)
        status = posed_body_create(c, j->body, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &p->posed);
    if (status == SHERF_OK)
        skin_pose(c, j->body, &p->skin, p->posed, s->normal, posed->position, posed->normal);
    lap(j, 2);
    return status;
}

/* ---- colours: of the surface in canonical space ---- */
/* Places and normals of the atlas's texels. */
static void texel_places(const surface *s, const atlas *a, float *position, float *normal) {
    for (int64_t i = 0; i < a->texels; i++) {
        const uint32_t *t = s->triangle + 3 * (size_t)a->face[i];
        const float b1 = a->barycentric[2 * i], b2 = a->barycentric[2 * i + 1], b0 = 1 - b1 - b2;
        float n[3], length = 0;
        for (size_t k = 0; k < 3; k++) {
            const float *p = s->position + k, *q = s->normal + k;
            position[3 * (size_t)i + k] =
                b0 * p[3 * (size_t)t[0]] + b1 * p[3 * (size_t)t[1]] + b2 * p[3 * (size_t)t[2]];
            n[k] = b0 * q[3 * (size_t)t[0]] + b1 * q[3 * (size_t)t[1]] + b2 * q[3 * (size_t)t[2]];
            length += n[k] * n[k];
        }
        length = sqrtf(length);
        for (size_t k = 0; k < 3; k++)
            normal[3 * (size_t)i + k] = length > 1e-6f ? n[k] / length : (float)(k == 1);
    }
}

/* The colours of places, with detail if requested. */
static sherf_status places_color(context *c, const bake_steps *j, int64_t n, const float *position,
                                 const float *normal, float *rgb) {
    sherf_status status = bake_colors(c, j->a, j->body, n, position, normal, rgb);
    if (status == SHERF_OK && j->o->detail) status = bake_detail(c, j->a, j->body, n, position, rgb);
    return status;
}

/* Colours of an atlas's texels. The network's colours are too soft to need every texel: a texel with all four
 * neighbours (texel_mean) takes their mean, and only its detail is computed for itself. */
static sherf_status texels_color(context *c, const bake_steps *j, const float *position, const float *normal,
                                 float *rgb) {
    const atlas *a = &j->out->atlas;
    texel_mesh mesh;
    sherf_status status = texel_mesh_make(c, a, position, &mesh);
    float *some = mem_alloc(c, (size_t)a->texels, 9 * sizeof *some);
    if (status == SHERF_OK && !some) status = SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        float *some_normal = some + 3 * mesh.count, *some_rgb = some + 6 * mesh.count;
        for (int64_t i = 0; i < mesh.count; i++) {
            memcpy(some + 3 * i, position + 3 * (size_t)mesh.texel[i], 3 * sizeof *some);
            memcpy(some_normal + 3 * i, normal + 3 * (size_t)mesh.texel[i], 3 * sizeof *some);
        }
        status = bake_colors(c, j->a, j->body, mesh.count, some, some_normal, some_rgb);
        if (status == SHERF_OK) texel_mesh_spread(a, &mesh, some_rgb, rgb);
    }
    mem_free(some);
    texel_mesh_free(&mesh);
    if (status == SHERF_OK && j->o->detail) status = bake_detail(c, j->a, j->body, a->texels, position, rgb);
    return status;
}

static sherf_status texture_make(context *c, bake_steps *j) {
    baked_person *p = j->out;
    atlas *a = &p->atlas;
    const size_t side = (size_t)j->o->texture_px;
    sherf_status status = atlas_make(c, &p->surface, j->o->texture_px, a);
    lap(j, 2);
    if (status != SHERF_OK) return status;
    p->report.charts = a->charts;
    const size_t n = (size_t)a->texels;
    float *position = mem_alloc(c, n, 3 * sizeof *position), *normal = mem_alloc(c, n, 3 * sizeof *normal);
    float *rgb = mem_alloc(c, n, 3 * sizeof *rgb);
    p->picture = mem_alloc(c, side * side, 3);
    status = position && normal && rgb && p->picture ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        texel_places(&p->surface, a, position, normal);
        status = texels_color(c, j, position, normal, rgb);
    }
    if (status == SHERF_OK) status = atlas_paint(c, a, rgb, p->picture);
    mem_free(position);
    mem_free(normal);
    mem_free(rgb);
    return status;
}

static sherf_status splats_color(context *c, bake_steps *j) {
    const surface *s = &j->out->surface;
    splats *p = &j->out->splats;
    sherf_status status = splats_make(c, s, j->o->splats, p);
    lap(j, 2);
    if (status != SHERF_OK) return status;
    j->out->report.splats = p->count;
    splats_place(s, s->position, s->normal, p);
    return places_color(c, j, p->count, p->position, p->normal, p->rgb);
}

static sherf_status vertices_color(context *c, bake_steps *j) {
    const surface *s = &j->out->surface;
    float *rgb = j->out->rgb = mem_alloc(c, (size_t)s->vertices, 3 * sizeof *rgb);
    return rgb ? places_color(c, j, s->vertices, s->position, s->normal, rgb) : SHERF_NO_MEMORY;
}

sherf_status baked_person_make(context *c, const sherf_avatar *a, const body_model *body,
                               const baked_options *o, baked_person *out) {
    bake_steps j = {.a = a, .body = body, .o = o, .out = out, .since_s = time_seconds()};
    surface posed = {0}; /* only the vertices */
    *out = (baked_person){0};
    sherf_status status = surface_make(c, &j);
    if (status == SHERF_OK) status = surface_pose(c, &j, &posed);
    if (status == SHERF_OK) {
        status = o->splats       ? splats_color(c, &j)
                 : o->texture_px ? texture_make(c, &j)
                                 : vertices_color(c, &j);
        lap(&j, 3);
    }
    if (status != SHERF_OK) {
        surface_free(&posed);
        return status;
    }
    mem_free(out->surface.position);
    mem_free(out->surface.normal);
    out->surface.position = posed.position;
    out->surface.normal = posed.normal;
    return SHERF_OK;
}

void baked_person_free(baked_person *p) {
    surface_free(&p->surface);
    skin_free(&p->skin);
    posed_body_free(p->posed);
    atlas_free(&p->atlas);
    splats_free(&p->splats);
    mem_free(p->rgb);
    mem_free(p->picture);
    *p = (baked_person){0};
}
