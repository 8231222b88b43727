#include "session.h"
#include "verbs.h"

static struct {
    const char *model, *body, *output;
    int64_t resolution;
    double level, islands;
    bool whole;
} set;

static const option options[] = {
    {'b', "body", OPTION_FILE, &set.body, "FILE",
     "the body model the avatar was made with (one beside it, or else the open body)"},
    {'m', "model", OPTION_FILE, &set.model, "FILE",
     "weights, where INPUT is an observation (the model that ships)"},
    {'o', "output", OPTION_FILE, &set.output, "FILE", "the file, .ply", .needed = true},
    {'r', "resolution", OPTION_INTEGER, &set.resolution, "N",
     "cells of the density along the body's longest side (256)", 16, 768},
    {0, "level", OPTION_REAL, &set.level, "X",
     "density of the surface, per metre (found: where its silhouettes are those of the frames)", 0, 1e6},
    {0, "islands", OPTION_REAL, &set.islands, "SHARE",
     "leave out pieces with less than this share of the largest one's area (0.02)", 0, 1},
    {0, "whole", OPTION_FLAG, &set.whole, NULL,
     "an observation is encoded as it is, not cut out round the person and scaled to what the model knows"},
    {0},
};

static int report(session *s, const sherf_exported *e, double seconds) {
    if (!common.json) {
        session_remark("%s: %lld vertices, %lld triangles, in %.1f s", set.output, (long long)e->vertices,
                       (long long)e->triangles, seconds);
        return EXIT_DONE;
    }
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "output", set.output);
    cJSON_AddNumberToObject(json, "vertices", (double)e->vertices);
    cJSON_AddNumberToObject(json, "triangles", (double)e->triangles);
    cJSON_AddNumberToObject(json, "islands", e->islands);
    cJSON_AddNumberToObject(json, "level_per_m", e->level);
    cJSON_AddNumberToObject(json, "export_s", seconds);
    cJSON_AddStringToObject(json, "precision", session_precision(s));
    session_json(json);
    return EXIT_DONE;
}

static int run(session *s, int count, char **argument) {
    sherf_body *body = NULL;
    sherf_avatar *avatar = NULL;
    sherf_exported exported;
    const char *body_path = session_body(s, set.body, argument[0]);
    if (!body_path) return EXIT_USAGE;
    int status = session_status(s, sherf_body_load(s->context, body_path, &body));
    if (!status) status = session_avatar(s, argument[0], set.model, body, set.whole, &avatar);
    const double begun_s = seconds_now();
    const sherf_export_options o = {
        .resolution = (int)set.resolution, .level = set.level, .islands = set.islands};
    if (!status)
        status = session_status(s, sherf_export(s->context, avatar, body, &o, set.output, &exported));
    if (!status) status = report(s, &exported, seconds_now() - begun_s);
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    return status;
}

const verb verb_export = {
    .name = "export",
    .arguments = "INPUT",
    .summary = "write an avatar as a file that other programs open",
    .description =
        "Writes the surface of an avatar file, or with --model of an observation, as a binary PLY mesh "
        "with normals and vertex colours. It is in canonical space: legs and feet apart, arms out, "
        "mean body shape. Axes: +Y up, the person faces +Z, metres.",
    .example = "sherf export ann.safetensors --body body.safetensors -o ann.ply\n"
               "sherf export ann/ -m model.safetensors -b body.safetensors --resolution 384 -o ann.ply",
    .options = options,
    .arguments_least = 1,
    .arguments_most = 1,
    .run = run,
};
