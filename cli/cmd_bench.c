/* sherf bench: times what users wait for and prints the library's report. */
#include <stdio.h>
#include <string.h>

#include "session.h"
#include "verbs.h"

#define DEMO "demo"

static struct {
    const char *preset;
    int64_t size, repeats;
} set = {.size = 512};

static const option options[] = {
    {'p', "preset", OPTION_TEXT, &set.preset, "NAME", "paper (the default), base or small, with settings"},
    {'s', "size", OPTION_INTEGER, &set.size, "N", "pictures are N x N (512)", 16, 8192},
    {'n', "repeats", OPTION_INTEGER, &set.repeats, "N",
     "timings; the median counts (what fits in a few seconds)", 0, 100000},
    {0},
};

/* What users run: the demo's made person and the shipped model, if the assets have them. */
typedef struct {
    sherf_model *model;
    sherf_body *body;
    sherf_observation *observation;
} person;

static int person_load(session *s, person *out) {
    char picture[4096];
    const char *weights = session_asset(NULL, "models/people.safetensors");
    const char *body = session_asset(NULL, "body.safetensors"),
               *listed = session_asset(NULL, DEMO "/human_list.txt");
    if (!weights || !body || !listed) {
        session_remark(
            "bench: the model that ships or the demo's person is not among the assets (looked in %s): "
            "the parts with them are left out",
            session_asset_places());
        return EXIT_DONE;
    }
    snprintf(picture, sizeof picture, "thuman:%.*s#person_900006/0/0",
             (int)(strlen(listed) - strlen("/human_list.txt")), listed);
    const char *path = picture;
    int status = session_status(s, sherf_body_load(s->context, body, &out->body));
    if (!status) status = session_status(s, sherf_model_load(s->context, weights, &out->model));
    if (!status) status = session_observations(s, 1, &path, out->model, out->body, false, &out->observation);
    return status;
}

static int run(session *s, int count, char **argument) {
    sherf_bench_options o = {
        .preset = set.preset, .size_px = (int)set.size, .repeats = (int)set.repeats, .json = common.json};
    person real = {0};
    char *text = NULL;
    int status = strcmp(argument[0], "train") ? person_load(s, &real) : EXIT_DONE;
    o.model = real.model;
    o.body = real.body;
    o.observation = real.observation;
    if (!status) status = session_status(s, sherf_bench(s->context, argument[0], &o, &text));
    if (!status) fputs(text, stdout);
    if (!status && *text && text[strlen(text) - 1] != '\n') putchar('\n');
    sherf_free(text);
    sherf_observation_free(real.observation);
    sherf_model_free(real.model);
    sherf_body_free(real.body);
    return status;
}

const verb verb_bench = {
    .name = "bench",
    .arguments = "render|avatar|train|export|bake",
    .summary = "time rendering, encoding, training, export or baking",
    .description =
        "Times the network with made-up weights on a built-in tube person and, but for train, the model that "
        "ships "
        "on the demo's made person (default_...). render gives frame_ms, exact_frame_ms, default_frame_ms, "
        "avatar_ms and points (samples that met the network); avatar gives avatar_ms; train gives step_ms; "
        "export "
        "gives export_ms, of a GLB; bake gives bake_ms and baked_frame_ms; all give isa, precision, device, "
        "peak_rss_mb, fma_gflops (float32 "
        "multiply-adds "
        "in registers, measured in the same run) and share_of_peak, what parts of the work reach of that.",
    .example = "sherf bench render --size 512 --json\nsherf bench train --preset small --size 256 --json",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .words = "render|avatar|train|export|bake",
    .computes = true,
    .run = run,
};
