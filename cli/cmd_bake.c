/* sherf bake: converts an avatar to the form that is drawn without its network. */
#include "session.h"
#include "shared.h"
#include "verbs.h"

#include <string.h>
#include <sys/stat.h>

static struct {
    const char *body, *model, *output;
    int64_t resolution, triangles, texture;
    bool no_detail, whole;
} set = {.resolution = 256, .triangles = 40000, .texture = 1024};

static const option options[] = {
    {'b', "body", OPTION_FILE, &set.body, "FILE",
     "the body model the avatar was made with (one beside INPUT, or else the open body)"},
    {'m', "model", OPTION_FILE, &set.model, "FILE",
     "weights; INPUT is an observation then (the model that ships)"},
    {'o', "output", OPTION_FILE, &set.output, "FILE", "the baked avatar", .needed = true},
    {'r', "resolution", OPTION_INTEGER, &set.resolution, "N",
     "cells of the density along the body's longest side (256)", 16, 768},
    {0, "triangles", OPTION_INTEGER, &set.triangles, "N", "of the surface (40000)", 100, 1000000},
    {0, "texture", OPTION_INTEGER, &set.texture, "N", "its side, a multiple of 8 (1024)", 64, 4096},
    SHARED_WHOLE(&set.whole),
    SHARED_NO_DETAIL(&set.no_detail),
    {0},
};

static int bake(session *s, const sherf_avatar *avatar, const sherf_body *body) {
    const sherf_bake_options o = {.resolution = (int)set.resolution,
                                  .triangles = (int)set.triangles,
                                  .texture_px = (int)set.texture,
                                  .detail = set.no_detail ? SHERF_DETAIL_OFF : SHERF_DETAIL_ON};
    sherf_avatar *baked = NULL;
    struct stat st;
    const double begun_s = seconds_now();
    int status = session_status(s, sherf_avatar_bake(s->context, avatar, body, &o, &baked));
    const double seconds = seconds_now() - begun_s;
    if (!status) status = session_status(s, sherf_avatar_save(s->context, baked, set.output));
    sherf_avatar_free(baked);
    if (status) return status;
    const double bytes = stat(set.output, &st) ? 0 : (double)st.st_size;
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "output", set.output);
        cJSON_AddNumberToObject(json, "bytes", bytes);
        cJSON_AddNumberToObject(json, "bake_s", seconds);
        session_json(json);
    } else {
        session_remark("%s: %.1f MB, baked in %.1f s", set.output, bytes / 1e6, seconds);
    }
    return EXIT_DONE;
}

static int run(session *s, int count, char **argument) {
    sherf_body *body = NULL;
    sherf_avatar *avatar = NULL;
    int status = session_person(s, argument[0], set.body, set.model, set.whole, &body, &avatar);
    if (!status) status = bake(s, avatar, body);
    sherf_avatar_free(avatar);
    sherf_body_free(body);
    return status;
}

const verb verb_bake = {
    .name = "bake",
    .arguments = "INPUT",
    .summary = "make an avatar that is drawn in milliseconds, without its network",
    .description =
        "Bakes an avatar file, or an observation, into a skinned surface with a texture. sherf render, sherf "
        "animate and sherf view take the file like any avatar, from any camera and in any pose, and "
        "draw it about a hundred times as fast; edges are harder than the network's, and there is no "
        "haze. --exact and sherf export need the network, and so the avatar that it was baked from.",
    .example = "sherf bake ann.safetensors -o ann.baked.safetensors\n"
               "sherf animate ann.baked.safetensors --motion walk.npz -o walk.mp4",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .computes = true,
    .run = run,
};
