/* sherf_export: the way from an avatar to a file. */
#include <math.h>
#include <string.h>

#include "base/path.h"
#include "baked/atlas.h"
#include "baked/baked.h"
#include "export/gltf.h"
#include "export/mesh_file.h"
#include "baked/skin.h"
#include "baked/splats.h"
#include "io/image.h"

typedef struct {
    const sherf_avatar *a;
    const body_model *m;
    sherf_export_options options;
    sherf_exported report;
    const char *path;
    double since_s;
    field_grid density;
    surface surface; /* canonical, then posed */
    skin skin;
    posed_body *target;
    float *position, *normal; /* of the surface's vertices in the target's world */
    float *rgb;               /* of vertices, or of texels */
    atlas atlas;
    uint8_t *picture;
    splats splats;
} export_job;

void sherf_pose_canonical(sherf_pose *out) {
    sherf_pose_identity(out);
    memcpy(out->poses_rad, body_big_pose, sizeof out->poses_rad);
}

/* ---- options ---- */
static sherf_status format_find(context *c, const char *path, sherf_export_options *o) {
    if (o->format < SHERF_EXPORT_AUTO || o->format > SHERF_EXPORT_SPLATS)
        return failure(c, SHERF_BAD_ARGUMENT, "export: there is no format %d", (int)o->format);
    if (o->format != SHERF_EXPORT_AUTO) return SHERF_OK;
    if (path_ends(path, ".glb"))
        o->format = SHERF_EXPORT_GLB;
    else if (path_ends(path, ".obj"))
        o->format = SHERF_EXPORT_OBJ;
    else if (path_ends(path, ".ply"))
        o->format = SHERF_EXPORT_PLY;
    else
        return failure(c, SHERF_BAD_ARGUMENT, "%s: exported files end in .glb, .obj or .ply", path);
    return SHERF_OK;
}

/* The pose that is to be written must be one, whether or not vertices are moved to it. */
static sherf_status pose_check(context *c, const export_job *j) {
    const sherf_pose *p = j->options.pose;
    posed_body *posed = NULL;
    if (!p) return SHERF_OK;
    sherf_status status = posed_body_create(c, j->m, p->poses_rad, p->shapes, p->R, p->Th_m, &posed);
    posed_body_free(posed);
    return status;
}

static sherf_status options_check(context *c, const sherf_export_options *given, export_job *j) {
    enum { TRIANGLES_MIN = 100 };
    sherf_export_options *o = &j->options;
    *o = given ? *given : (sherf_export_options){0};
    sherf_status status = format_find(c, j->path, o);
    if (status != SHERF_OK) return status;
    if (!o->resolution) o->resolution = 256;
    if (!(o->level >= 0 && o->level <= 1e6))
        return failure(c, SHERF_BAD_ARGUMENT, "level %g: must be 0 to 1000000 per metre", o->level);
    if (!(o->islands >= 0 && o->islands <= 1))
        return failure(c, SHERF_BAD_ARGUMENT, "islands %g: must be 0 to 1", o->islands);
    if (o->islands == 0) o->islands = 0.02;
    if (!o->triangles) o->triangles = 50000;
    if (o->triangles > 0 && o->triangles < TRIANGLES_MIN)
        return failure(c, SHERF_BAD_ARGUMENT, "%d triangles: must be %d or more", o->triangles,
                       TRIANGLES_MIN);
    if (!o->texture_px) o->texture_px = 1024;
    if (o->texture_px > 0 && (o->texture_px < ATLAS_SIDE_MIN || o->texture_px > ATLAS_SIDE_MAX))
        return failure(c, SHERF_BAD_ARGUMENT, "texture of %d texels: must be %d to %d", o->texture_px,
                       ATLAS_SIDE_MIN, ATLAS_SIDE_MAX);
    if (!o->splats) o->splats = 100000;
    if (o->splats < 1 || o->splats > SPLATS_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%d splats: must be 1 to %d", o->splats, SPLATS_MAX);
    if (o->up < SHERF_UP_AUTO || o->up > SHERF_UP_MINUS_Y)
        return failure(c, SHERF_BAD_ARGUMENT, "export: there is no up axis %d", (int)o->up);
    if (o->format == SHERF_EXPORT_GLB && o->up != SHERF_UP_AUTO && o->up != SHERF_UP_Y)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a .glb always has +Y up", j->path);
    if (o->format != SHERF_EXPORT_GLB && o->motion)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a motion goes into a .glb only", j->path);
    if (j->m->fingerprint != j->a->body_fingerprint)
        return failure(c, SHERF_MISMATCH, "the avatar was made with another body");
    return pose_check(c, j);
}

static bool textured(const export_job *j) {
    return j->options.texture_px > 0 &&
           (j->options.format == SHERF_EXPORT_GLB || j->options.format == SHERF_EXPORT_OBJ);
}

/* ---- surface ---- */
static void lap(export_job *j, int part) {
    double now_s = time_seconds();
    j->report.seconds[part] += now_s - j->since_s;
    j->since_s = now_s;
}

/* Density to a clean surface in canonical space. */
static sherf_status surface_make(context *c, export_job *j) {
    const sherf_export_options *o = &j->options;
    float level = (float)o->level;
    sherf_status status = field_density(c, j->a, j->m, o->resolution, &j->density);
    if (status == SHERF_OK && !(level > 0)) {
        status = field_level(c, &j->density, &level);
        if (status == SHERF_OK) status = field_level_places(c, &j->density, level);
    }
    j->report.level = level;
    if (status == SHERF_OK) status = field_solidify(c, &j->density, level);
    if (status == SHERF_OK) status = cubes_surface(c, &j->density, level, &j->surface);
    if (status == SHERF_OK) status = surface_keep_large(c, &j->surface, o->islands, &j->report.islands);
    if (status == SHERF_OK && !j->surface.triangles)
        status = failure(c, SHERF_BAD_ARGUMENT, "level %g: the avatar is nowhere that dense", (double)level);
    lap(j, 0);
    /* splats lie on the whole surface */
    if (status == SHERF_OK && o->triangles > 0 && o->format != SHERF_EXPORT_SPLATS)
        status = surface_reduce(c, &j->surface, o->triangles);
    if (status == SHERF_OK) status = surface_normals(c, &j->surface, &j->density);
    j->report.vertices = j->surface.vertices;
    j->report.triangles = j->surface.triangles;
    lap(j, 1);
    return status;
}

/* ---- colours ---- */
/* Places and normals of the atlas's texels. */
static void texel_places(const export_job *j, float *position, float *normal) {
    const atlas *a = &j->atlas;
    for (int64_t i = 0; i < a->texels; i++) {
        const uint32_t *t = j->surface.triangle + 3 * (size_t)a->face[i];
        const float b1 = a->barycentric[2 * i], b2 = a->barycentric[2 * i + 1], b0 = 1 - b1 - b2;
        float n[3], length = 0;
        for (size_t k = 0; k < 3; k++) {
            const float *p = j->surface.position + k, *q = j->surface.normal + k;
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

static sherf_status texture_make(context *c, export_job *j) {
    const bool detail = j->options.detail != SHERF_DETAIL_OFF;
    atlas *a = &j->atlas;
    const size_t side = (size_t)j->options.texture_px;
    sherf_status status = atlas_make(c, &j->surface, j->options.texture_px, a);
    lap(j, 2);
    if (status != SHERF_OK) return status;
    j->report.charts = a->charts;
    const size_t n = (size_t)a->texels;
    float *position = mem_alloc(c, n, 3 * sizeof *position), *normal = mem_alloc(c, n, 3 * sizeof *normal);
    j->rgb = mem_alloc(c, n, 3 * sizeof *j->rgb);
    j->picture = mem_alloc(c, side * side, 3);
    status = position && normal && j->rgb && j->picture ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        texel_places(j, position, normal);
        status = bake_colors(c, j->a, j->m, detail, a->texels, position, normal, j->rgb);
    }
    if (status == SHERF_OK) status = atlas_paint(c, a, j->rgb, j->picture);
    mem_free(position);
    mem_free(normal);
    return status;
}

static sherf_status colors_make(context *c, export_job *j) {
    const bool detail = j->options.detail != SHERF_DETAIL_OFF;
    const surface *s = &j->surface;
    sherf_status status = SHERF_OK;
    if (j->options.format == SHERF_EXPORT_SPLATS) {
        status = splats_make(c, s, j->options.splats, &j->splats);
        lap(j, 2);
        if (status != SHERF_OK) return status;
        j->report.splats = j->splats.count;
        splats_place(s, s->position, s->normal, &j->splats);
        status = bake_colors(c, j->a, j->m, detail, j->splats.count, j->splats.position, j->splats.normal,
                             j->splats.rgb);
    } else if (textured(j)) {
        status = texture_make(c, j);
    } else {
        j->rgb = mem_alloc(c, (size_t)s->vertices, 3 * sizeof *j->rgb);
        status = j->rgb ? bake_colors(c, j->a, j->m, detail, s->vertices, s->position, s->normal, j->rgb)
                        : SHERF_NO_MEMORY;
    }
    lap(j, 3);
    return status;
}

/* ---- posing ---- */
/* The rest pose of the avatar's shape, which files are bound in. */
static void rest_pose(const export_job *j, sherf_pose *out) {
    sherf_pose_identity(out);
    memcpy(out->shapes, j->a->pose.shapes, sizeof out->shapes);
}

static sherf_status pose_surface(context *c, export_job *j) {
    const size_t V = (size_t)j->surface.vertices;
    sherf_pose pose;
    rest_pose(j, &pose);
    if (j->options.pose && j->options.format != SHERF_EXPORT_GLB) pose = *j->options.pose;
    j->position = mem_alloc(c, V, 3 * sizeof *j->position);
    j->normal = mem_alloc(c, V, 3 * sizeof *j->normal);
    sherf_status status = j->position && j->normal ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = skin_make(c, j->m, j->surface.vertices, j->surface.position, &j->skin);
    if (status == SHERF_OK)
        status = posed_body_create(c, j->m, pose.poses_rad, pose.shapes, pose.R, pose.Th_m, &j->target);
    if (status == SHERF_OK)
        skin_pose(c, j->m, &j->skin, j->target, j->surface.normal, j->position, j->normal);
    lap(j, 2);
    return status;
}

/* From y up to the axes asked for; n vectors. */
static void turn_axes(sherf_up up, int64_t n, float *x) {
    for (int64_t i = 0; i < n; i++, x += 3) {
        float y = x[1], z = x[2];
        if (up == SHERF_UP_Z) x[1] = -z, x[2] = y;
        if (up == SHERF_UP_MINUS_Y) x[1] = -y, x[2] = -z;
    }
}

static const char *axes_text(const export_job *j) {
    const bool posed = j->options.pose != NULL;
    switch (j->options.up) {
    case SHERF_UP_Z:
        return posed ? "metres, +Z up where the pose's world has +Y up" : "+Z up, facing -Y, metres";
    case SHERF_UP_MINUS_Y:
        return posed ? "metres, -Y up where the pose's world has +Y up" : "-Y up, facing -Z, metres";
    default:
        return posed ? "metres, the pose's world (+Y up as a rule)" : "+Y up, facing +Z, metres";
    }
}

/* ---- files ---- */
/* The vertices of a .glb: one for each corner of the atlas, or the surface's own. */
typedef struct {
    float *position, *normal, *uv, *weight;
    uint8_t *joint;
    unsigned char *png;
    sherf_pose *clip;
} glb_room;

static sherf_status glb_corners(context *c, const export_job *j, glb_room *r) {
    const atlas *a = &j->atlas;
    const size_t n = (size_t)a->corners;
    r->position = mem_alloc(c, n, 3 * sizeof(float));
    r->normal = mem_alloc(c, n, 3 * sizeof(float));
    r->uv = mem_alloc(c, n, 2 * sizeof(float));
    r->joint = mem_alloc(c, n, 4);
    r->weight = mem_alloc(c, n, 4 * sizeof(float));
    if (!r->position || !r->normal || !r->uv || !r->joint || !r->weight) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) {
        const size_t v = a->vertex[i];
        memcpy(r->position + 3 * i, j->position + 3 * v, 3 * sizeof(float));
        memcpy(r->normal + 3 * i, j->normal + 3 * v, 3 * sizeof(float));
        memcpy(r->joint + 4 * i, j->skin.joint + 4 * v, 4);
        memcpy(r->weight + 4 * i, j->skin.weight + 4 * v, 4 * sizeof(float));
        for (size_t k = 0; k < 2; k++) r->uv[2 * i + k] = (a->uv[2 * i + k] + 0.5f) / (float)a->side_px;
    }
    return SHERF_OK;
}

static sherf_status glb_write(context *c, export_job *j) {
    const sherf_motion *motion = j->options.motion;
    glb_room r = {0};
    gltf_person g = {.vertices = j->surface.vertices,
                     .triangles = j->surface.triangles,
                     .position = j->position,
                     .normal = j->normal,
                     .rgb = j->rgb,
                     .joint = j->skin.joint,
                     .weight = j->skin.weight,
                     .triangle = j->surface.triangle,
                     .parent = j->m->parent,
                     .joints_rest = j->target->joints_rest,
                     .pose = j->options.pose,
                     .lit = j->options.lit};
    sherf_status status = SHERF_OK;
    if (textured(j)) {
        status = glb_corners(c, j, &r);
        if (status == SHERF_OK)
            status =
                png_to_memory(c, j->atlas.side_px, j->atlas.side_px, 3, j->picture, 6, &r.png, &g.png_bytes);
        g.vertices = j->atlas.corners;
        g.position = r.position;
        g.normal = r.normal;
        g.uv = r.uv;
        g.joint = r.joint;
        g.weight = r.weight;
        g.triangle = j->atlas.triangle;
        g.png = r.png;
    }
    if (status == SHERF_OK && motion) {
        g.frames = sherf_motion_frame_count(motion);
        g.fps = sherf_motion_fps(motion);
        g.clip = r.clip = mem_alloc(c, (size_t)g.frames, sizeof *r.clip);
        if (!r.clip) status = SHERF_NO_MEMORY;
        for (int f = 0; f < g.frames && r.clip; f++) sherf_motion_pose(motion, f, &r.clip[f]);
    }
    if (status == SHERF_OK) status = gltf_write(c, j->path, &g);
    mem_free(r.position);
    mem_free(r.normal);
    mem_free(r.uv);
    mem_free(r.joint);
    mem_free(r.weight);
    mem_free(r.png);
    mem_free(r.clip);
    return status;
}

static sherf_status file_write(context *c, export_job *j) {
    if (j->options.format == SHERF_EXPORT_GLB) return glb_write(c, j);
    surface posed = j->surface;
    posed.position = j->position;
    posed.normal = j->normal;
    turn_axes(j->options.up, posed.vertices, posed.position);
    turn_axes(j->options.up, posed.vertices, posed.normal);
    if (j->options.format == SHERF_EXPORT_SPLATS) {
        splats_place(&posed, posed.position, posed.normal, &j->splats);
        return ply_splats_write(c, j->path, axes_text(j), &j->splats);
    }
    if (j->options.format == SHERF_EXPORT_PLY)
        return ply_mesh_write(c, j->path, axes_text(j), &posed, j->rgb);
    return obj_write(c, j->path, axes_text(j), &posed, textured(j) ? &j->atlas : NULL, j->picture, j->rgb);
}

sherf_status sherf_export(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                          const sherf_export_options *options, const char *path, sherf_exported *out) {
    export_job j = {.a = avatar, .m = body, .path = path, .since_s = time_seconds()};
    if (out) *out = (sherf_exported){0};
    sherf_status status = options_check(c, options, &j);
    if (status == SHERF_OK) status = surface_make(c, &j);
    if (status == SHERF_OK) status = pose_surface(c, &j);
    if (status == SHERF_OK) status = colors_make(c, &j);
    if (status == SHERF_OK) status = file_write(c, &j);
    field_grid_free(&j.density);
    surface_free(&j.surface);
    skin_free(&j.skin);
    posed_body_free(j.target);
    atlas_free(&j.atlas);
    splats_free(&j.splats);
    mem_free(j.position);
    mem_free(j.normal);
    mem_free(j.rgb);
    mem_free(j.picture);
    if (status == SHERF_OK && out) *out = j.report;
    return status;
}
