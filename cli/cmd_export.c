/* sherf export: writes an avatar as a rigged .glb, a textured .obj, a .ply mesh or .ply splats. */
#include <stdlib.h>
#include <string.h>

#include "session.h"
#include "shared.h"
#include "verbs.h"

static struct {
    const char *model, *body, *output, *pose, *motion, *joints;
    int format, up;
    int64_t resolution, triangles, texture, splats, frame;
    double level, islands, fps;
    bool vertex_colors, all_triangles, lit, no_detail, whole;
} set;

static const option options[] = {
    SHARED_BODY_OF_AVATAR(&set.body),
    SHARED_WEIGHTS_OF_OBSERVATION('m', &set.model),
    {'o', "output", OPTION_FILE, &set.output, "FILE", "the file: .glb, .obj or .ply", .needed = true},
    {'f', "format", OPTION_CHOICE, &set.format, "auto|glb|obj|ply|splats",
     "auto goes by the name; ply is a mesh, splats a .ply of 3D Gaussians"},
    {'p', "pose", OPTION_TEXT, &set.pose, "rest|canonical|observation|FILE",
     "what the person does (rest: a T); a .glb's joints take it, its mesh is bound in the T"},
    {0, "frame", OPTION_INTEGER, &set.frame, "N", "which pose of a FILE of several, from 0 (0)", 0, 1000000},
    {0, "motion", OPTION_FILE, &set.motion, "FILE", "a motion (docs/motion.md) as the animation of a .glb"},
    {0, "joints", OPTION_FILE, &set.joints, "MAP.json",
     "names of the motion's joints, as for sherf animate (recognised)"},
    {0, "fps", OPTION_REAL, &set.fps, "X", "frames a second of the animation (the motion's own)", 0.1, 1000},
    {'r', "resolution", OPTION_INTEGER, &set.resolution, "N",
     "cells of the density along the body's longest side (256)", 16, 768},
    {0, "triangles", OPTION_INTEGER, &set.triangles, "N", "reduce the surface to so many (50000)", 100,
     100000000},
    {0, "all-triangles", OPTION_FLAG, &set.all_triangles, NULL, "do not reduce the surface"},
    {0, "texture", OPTION_INTEGER, &set.texture, "PX", "side of the texture of .glb and .obj (1024)", 64,
     4096},
    {0, "vertex-colors", OPTION_FLAG, &set.vertex_colors, NULL,
     "colours of the vertices instead of a texture"},
    {0, "splats", OPTION_INTEGER, &set.splats, "N", "how many Gaussians (100000)", 1, 10000000},
    {0, "no-detail", OPTION_FLAG, &set.no_detail, NULL,
     "the network's soft colours alone; otherwise what the picture shows is given back where it was seen"},
    {0, "lit", OPTION_FLAG, &set.lit, NULL,
     "light falls on a .glb's material; otherwise it shows its colours as they are"},
    {0, "up", OPTION_CHOICE, &set.up, "y|z|-y", "up axis of .obj and .ply; a .glb has +Y up"},
    {0, "level", OPTION_REAL, &set.level, "X",
     "density of the surface, per metre (found by place: where its silhouettes are those of the frames)", 0,
     1e6},
    {0, "islands", OPTION_REAL, &set.islands, "SHARE",
     "leave out pieces with less than this share of the largest one's area (0.02)", 0, 1},
    SHARED_WHOLE(&set.whole),
    {0},
};

/* *out: the pose, or NULL for the rest pose. A file's poses keep the person's own shape. */
static int pose_find(session *s, const sherf_avatar *avatar, sherf_pose *room, const sherf_pose **out) {
    *out = NULL;
    if (!set.pose || !strcmp(set.pose, "rest")) return EXIT_DONE;
    *out = room;
    if (!strcmp(set.pose, "canonical")) {
        sherf_pose_canonical(room);
        return EXIT_DONE;
    }
    if (!strcmp(set.pose, "observation")) {
        *room = *sherf_avatar_pose(avatar);
        return EXIT_DONE;
    }
    sherf_pose *poses = NULL;
    int count = 0, status = session_status(s, sherf_poses_load(s->context, set.pose, &poses, &count));
    if (!status && set.frame >= count)
        status = session_failure("%s: --frame %lld, but it has %d pose%s", set.pose, (long long)set.frame,
                                 count, count == 1 ? "" : "s");
    if (!status) {
        *room = poses[set.frame];
        memcpy(room->shapes, sherf_avatar_pose(avatar)->shapes, sizeof room->shapes);
    }
    sherf_free(poses);
    return status;
}

static int motion_find(session *s, const sherf_avatar *avatar, const sherf_body *body, sherf_motion **out) {
    *out = NULL;
    if (!set.motion) return EXIT_DONE;
    const sherf_motion_options o = {
        .fps = set.fps, .joints = set.joints, .body = body, .shapes = sherf_avatar_pose(avatar)->shapes};
    return session_status(s, sherf_motion_load(s->context, set.motion, &o, out));
}

static int report(session *s, const sherf_exported *e, double seconds) {
    if (!common.json) {
        if (e->splats)
            session_remark("%s: %lld splats, in %.1f s", set.output, (long long)e->splats, seconds);
        else
            session_remark("%s: %lld vertices, %lld triangles, in %.1f s", set.output, (long long)e->vertices,
                           (long long)e->triangles, seconds);
        return EXIT_DONE;
    }
    static const char *const part[] = {"surface_s", "reduction_s", "skin_s", "colors_s"};
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "output", set.output);
    cJSON_AddNumberToObject(json, "vertices", (double)e->vertices);
    cJSON_AddNumberToObject(json, "triangles", (double)e->triangles);
    cJSON_AddNumberToObject(json, "splats", (double)e->splats);
    cJSON_AddNumberToObject(json, "charts", e->charts);
    cJSON_AddNumberToObject(json, "islands", e->islands);
    cJSON_AddNumberToObject(json, "level_per_m", e->level);
    for (int i = 0; i < 4; i++) cJSON_AddNumberToObject(json, part[i], e->seconds[i]);
    cJSON_AddNumberToObject(json, "export_s", seconds);
    cJSON_AddStringToObject(json, "precision", session_precision(s));
    session_json(json);
    return EXIT_DONE;
}

static int export_avatar(session *s, const sherf_avatar *avatar, const sherf_body *body) {
    static const sherf_up ups[] = {SHERF_UP_AUTO, SHERF_UP_Z, SHERF_UP_MINUS_Y};
    static const char *const formats[] = {NULL, "glb", "obj", "ply", "splats"};
    sherf_pose pose;
    sherf_motion *motion = NULL;
    sherf_exported exported;
    sherf_export_options o = {.format = formats[set.format],
                              .resolution = (int)set.resolution,
                              .level = set.level,
                              .islands = set.islands,
                              .triangles = set.all_triangles ? -1 : (int)set.triangles,
                              .texture_px = set.vertex_colors ? -1 : (int)set.texture,
                              .splats = (int)set.splats,
                              .lit = set.lit,
                              .up = ups[set.up],
                              .detail = set.no_detail ? SHERF_DETAIL_OFF : SHERF_DETAIL_ON};
    int status = pose_find(s, avatar, &pose, &o.pose);
    if (!status) status = motion_find(s, avatar, body, &motion);
    o.motion = motion;
    const double begun_s = seconds_now();
    if (!status)
        status = session_status(s, sherf_export(s->context, avatar, body, &o, set.output, &exported));
    if (!status) status = report(s, &exported, seconds_now() - begun_s);
    sherf_motion_free(motion);
    return status;
}

static int run(session *s, int count, char **argument) {
    sherf_body *body = NULL;
    sherf_avatar *avatar = NULL;
    if (set.fps > 0 && !set.motion) return usage_error(s->verb_name, "--fps needs --motion");
    if (set.joints && !set.motion) return usage_error(s->verb_name, "--joints needs --motion");
    int status = session_person(s, argument[0], set.body, set.model, set.whole, &body, &avatar);
    if (!status) status = export_avatar(s, avatar, body);
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    return status;
}

const verb verb_export = {
    .name = "export",
    .arguments = "INPUT",
    .summary = "write an avatar as a file that Blender, Unity or a browser opens",
    .description =
        "Writes an avatar file, or an observation, as a rigged .glb (closed surface, skin of 24 joints by "
        "SMPL's "
        "names, texture, and with --motion an animation), as an .obj with its texture, as a .ply mesh with "
        "vertex colours, or as a .ply of 3D Gaussian splats. Axes: +Y up, the person faces +Z in rest pose, "
        "metres; a pose from a file or the picture keeps its world.",
    .example = "sherf export ann.safetensors --body body.safetensors -o ann.glb\n"
               "sherf export ann.safetensors --motion walk.npz -o ann.glb\n"
               "sherf export ann/ --pose observation --format splats -o ann.ply",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .computes = true,
    .many_kinds = true,
    .run = run,
};
