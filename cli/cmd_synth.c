#include "session.h"
#include "verbs.h"

static struct {
    const char *output;
    int64_t people, poses, views, size;
} set = {.people = 4, .poses = 6, .views = 24, .size = 256};

static const option options[] = {
    {'o', "output", OPTION_FILE, &set.output, "FOLDER", "where the data set goes", .needed = true},
    {'n', "people", OPTION_INTEGER, &set.people, "N", "people (4)", 1, 1000},
    {0, "poses", OPTION_INTEGER, &set.poses, "N", "poses of each (6)", 1, 10000},
    {0, "views", OPTION_INTEGER, &set.views, "N", "cameras round them (24)", 1, 360},
    {'s', "size", OPTION_INTEGER, &set.size, "N", "pictures are N x N (256)", 16, 4096},
    {0},
};

static int run(session *s, int count, char **argument) {
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

const verb verb_synth = {
    .name = "synth",
    .arguments = "tube",
    .summary = "make a data set of striped tube people",
    .description =
        "Draws tube people with stripes and coloured limbs from cameras all round, in the layout of "
        "THuman, with their body file FOLDER/tubeman.safetensors: something to train and test on "
        "that belongs to nobody.",
    .example = "sherf synth tube -o people --people 8 --poses 12 --size 256",
    .options = options,
    .arguments_least = 1,
    .arguments_most = 1,
    .words = "tube",
    .run = run,
};
