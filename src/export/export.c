/* sherf_export: checks the options, chooses the format, and converts an avatar to a file. */
#include "export/export.h"

#include <string.h>

#include "base/path.h"

#define EXPORT_ENTRY(name) &export_##name,
static const export_format *const formats[] = {EXPORT_FORMATS(EXPORT_ENTRY)};

void sherf_pose_canonical(sherf_pose *out) {
    sherf_pose_identity(out);
    memcpy(out->poses_rad, body_big_pose, sizeof out->poses_rad);
}

/* ---- options ---- */
/* Lists the formats' names, or file endings: "a, b or c". */
static void known_list(bool names, char *out, size_t room) {
    const char *known[COUNT_OF(formats)];
    size_t count = 0, n = 0;
    for (size_t i = 0; i < COUNT_OF(formats); i++) {
        const char *word = names ? formats[i]->name : formats[i]->ending;
        if (word) known[count++] = word;
    }
    for (size_t i = 0; i < count && n < room; i++)
        n += (size_t)snprintf(out + n, room - n, "%s%s", !i ? "" : i + 1 < count ? ", " : " or ", known[i]);
}

/* Finds a format by its name, or if that is NULL by the file's ending. */
static sherf_status format_find(context *c, const char *path, const char *name, const export_format **out) {
    char known[200];
    for (size_t i = 0; i < COUNT_OF(formats); i++) {
        const export_format *f = *out = formats[i];
        if (name ? !strcmp(name, f->name) : f->ending && path_ends(path, f->ending)) return SHERF_OK;
    }
    *out = NULL;
    known_list(name != NULL, known, sizeof known);
    if (name)
        return failure(c, SHERF_BAD_ARGUMENT, "export: there is no format '%.40s': there is %s", name, known);
    return failure(c, SHERF_BAD_ARGUMENT, "%s: exported files end in %s", path, known);
}

/* The requested pose must be valid, even if vertices are not moved to it. */
static sherf_status pose_check(context *c, const body_model *body, const sherf_pose *p) {
    posed_body *posed = NULL;
    if (!p) return SHERF_OK;
    sherf_status status = posed_body_create(c, body, p->poses_rad, p->shapes, p->R, p->Th_m, &posed);
    posed_body_free(posed);
    return status;
}

/* Replaces zeros by defaults. */
static sherf_status options_check(context *c, const char *path, const export_format *format,
                                  sherf_export_options *o) {
    enum { TRIANGLES_MIN = 100 };
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
    if (format->rigged && o->up != SHERF_UP_AUTO && o->up != SHERF_UP_Y)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a .%s always has +Y up", path, format->name);
    if (!format->rigged && o->motion)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: a motion goes into a .glb only", path);
    return SHERF_OK;
}

/* ---- axes ---- */
/* Turns n vectors from y up to the requested axes. */
static void turn_axes(sherf_up up, int64_t n, float *x) {
    for (int64_t i = 0; i < n; i++, x += 3) {
        float y = x[1], z = x[2];
        if (up == SHERF_UP_Z) x[1] = -z, x[2] = y;
        if (up == SHERF_UP_MINUS_Y) x[1] = -y, x[2] = -z;
    }
}

static const char *axes_text(const sherf_export_options *o) {
    const bool posed = o->pose != NULL;
    switch (o->up) {
    case SHERF_UP_Z:
        return posed ? "metres, +Z up where the pose's world has +Y up" : "+Z up, facing -Y, metres";
    case SHERF_UP_MINUS_Y:
        return posed ? "metres, -Y up where the pose's world has +Y up" : "-Y up, facing -Z, metres";
    default:
        return posed ? "metres, the pose's world (+Y up as a rule)" : "+Y up, facing +Z, metres";
    }
}

/* ---- the whole ---- */
static baked_options what_to_bake(const sherf_export_options *o, const export_format *format) {
    return (baked_options){.resolution = o->resolution,
                           .level = o->level,
                           .islands = o->islands,
                           .triangles = format->splats || o->triangles < 0 ? 0 : o->triangles,
                           .texture_px = format->texture && o->texture_px > 0 ? o->texture_px : 0,
                           .splats = format->splats ? o->splats : 0,
                           .detail = o->detail != SHERF_DETAIL_OFF,
                           .pose = format->rigged ? NULL : o->pose};
}

sherf_status sherf_export(sherf_context *c, const sherf_avatar *avatar, const sherf_body *body,
                          const sherf_export_options *options, const char *path, sherf_exported *out) {
    sherf_export_options o = options ? *options : (sherf_export_options){0};
    const export_format *format = NULL;
    baked_person person = {0};
    if (out) *out = (sherf_exported){0};
    sherf_status status = format_find(c, path, o.format, &format);
    if (status == SHERF_OK) status = options_check(c, path, format, &o);
    if (status == SHERF_OK) status = avatar_needs_network(c, avatar, "an export needs");
    if (status == SHERF_OK) status = avatar_check_body(c, avatar, body);
    if (status == SHERF_OK) status = pose_check(c, body, o.pose);
    if (status == SHERF_OK) {
        const baked_options bake = what_to_bake(&o, format);
        status = baked_person_make(c, avatar, body, &bake, &person);
    }
    if (status == SHERF_OK) {
        surface *s = &person.surface;
        turn_axes(o.up, s->vertices, s->position);
        turn_axes(o.up, s->vertices, s->normal);
        if (format->splats) splats_place(s, s->position, s->normal, &person.splats);
        status = format->write(c, &(export_job){path, axes_text(&o), &person, body, &o});
    }
    if (status == SHERF_OK && out) *out = person.report;
    baked_person_free(&person);
    return status;
}
