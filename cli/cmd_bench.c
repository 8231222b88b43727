/* sherf bench: times rendering or training and prints what the library reports. */
#include <string.h>

#include "session.h"
#include "verbs.h"

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

static int run(session *s, int count, char **argument) {
    sherf_bench_options o = {
        .preset = set.preset, .size_px = (int)set.size, .repeats = (int)set.repeats, .json = common.json};
    char *text = NULL;
    int status = session_status(s, sherf_bench(s->context, argument[0], &o, &text));
    if (!status) fputs(text, stdout);
    if (!status && *text && text[strlen(text) - 1] != '\n') putchar('\n');
    sherf_free(text);
    return status;
}

const verb verb_bench = {
    .name = "bench",
    .arguments = "render|train|bake",
    .summary = "time rendering, training or baking",
    .description =
        "Times the network with made-up weights on a built-in tube person. render gives avatar_ms, frame_ms, "
        "points (samples that met the network), precision, device and peak_rss_mb; train gives step_ms, "
        "device "
        "and peak_rss_mb; bake gives bake_ms and baked_frame_ms.",
    .example = "sherf bench render --size 512 --json\nsherf bench train --preset small --size 256 --json",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .words = "render|train|bake",
    .computes = true,
    .run = run,
};
