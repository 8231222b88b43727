/* sherf info: describes each file's kind and contents, as text or JSON. */
#include <string.h>

#include "session.h"
#include "verbs.h"

static const option options[] = {{0}};

static int run(session *s, int count, char **argument) {
    int status = EXIT_DONE;
    for (int i = 0; i < count && !status; i++) {
        char *text = NULL;
        status = session_status(s, sherf_info(s->context, argument[i], common.json, &text));
        if (!status) fputs(text, stdout);
        if (!status && *text && text[strlen(text) - 1] != '\n') putchar('\n');
        sherf_free(text);
    }
    return status;
}

const verb verb_info = {
    .name = "info",
    .arguments = "FILE...",
    .summary = "describe any file the program knows",
    .description =
        "Says what a file is and what is in it: weights, avatars, bodies, observations, data sets, "
        "pictures, npy and npz arrays, checkpoints.",
    .example = "sherf info model.safetensors\nsherf info thuman:THuman/nerf_data_ --json",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1000,
    .run = run,
};
