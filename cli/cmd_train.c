/* sherf train: passes its options to the library's training; with --json it prints the model file's name. */
#include "photo.h"
#include "session.h"
#include "shared.h"
#include "verbs.h"

static struct {
    const char *data, *people, *body, *output, *preset, *resnet, *lpips, *perceptual, *resume, *background,
        *start, *without;
    bool front_view, last_weights;
    int64_t size, steps, batch, targets, pictures, halve_every, halve_pictures, sample_every, save_every,
        workers;
    double epochs, seconds, learning_rate, perceptual_weight, estimated, beta2;
} set;

static const option options[] = {
    SHARED_DATA(&set.data),
    {'P', "people", OPTION_TEXT, &set.people, "LIST",
     "names, or a range 0-89 of the data set's list (the paper's training people)"},
    SHARED_BODY_OF_DATA(&set.body),
    {'o', "output", OPTION_FILE, &set.output, "FOLDER",
     "model, checkpoint, log.jsonl, loss.png, samples; a checkpoint that is there is continued",
     .needed = true},
    {'p', "preset", OPTION_TEXT, &set.preset, "NAME",
     "paper, base or small, with settings: small,plane_resolution=64; of another model: "
     "pixelnerf:own-small (paper)"},
    {0, "resnet", OPTION_FILE, &set.resnet, "FILE", "start the encoders from a converted ResNet-18 (34)"},
    SHARED_LPIPS(&set.lpips, ", for the fourth loss"),
    SHARED_PERCEPTUAL(&set.perceptual, "the fourth loss where no --lpips is given", "three losses"),
    {0, "perceptual-weight", OPTION_REAL, &set.perceptual_weight, "X", "of that distance (0.3)", 1e-6, 1e6},
    {0, "without", OPTION_TEXT, &set.without, "LIST",
     "terms left out of the loss: color, mask, ssim, perceptual, with commas between"},
    {'r', "resume", OPTION_FILE, &set.resume, "FILE", "continue from this checkpoint"},
    {0, "start", OPTION_FILE, &set.start, "FILE",
     "begin with these weights, of any training, instead of new ones (fine-tuning)"},
    {0, "estimated", OPTION_REAL, &set.estimated, "X",
     "share of the observations whose camera, body and mask are estimated from the picture alone (0)", 0, 1},
    {0, "background", OPTION_TEXT, &set.background, "KIND",
     "black, the paper's, or random: greys drawn for every picture, so that dark people become opaque too"},
    {0, "front-view", OPTION_FLAG, &set.front_view, NULL, "observe people from the front view only"},
    SHARED_WIDTH(&set.size, 8192),
    {0, "epochs", OPTION_REAL, &set.epochs, "X", "stop after X epochs (5)", 1e-6, 1e6},
    {'n', "steps", OPTION_INTEGER, &set.steps, "N", "stop after N steps", 1, 1e12},
    {0, "seconds", OPTION_REAL, &set.seconds, "X", "stop after X seconds", 1e-3, 1e9},
    {0, "batch", OPTION_INTEGER, &set.batch, "N", "samples a step, over all processes (4)", 1, 4096},
    {0, "targets", OPTION_INTEGER, &set.targets, "N",
     "pictures rendered of each observed person (1, the paper's); the further ones in any pose", 1, 8},
    {0, "pictures", OPTION_INTEGER, &set.pictures, "N",
     "every other observation has 2 to N pictures, each from another view, in any pose (1)", 1,
     SHERF_PICTURES_MAX},
    {0, "learning-rate", OPTION_REAL, &set.learning_rate, "X", "Adam's at the start (0.002)", 1e-9, 10},
    {0, "beta2", OPTION_REAL, &set.beta2, "X", "Adam's, of the squared gradients (0.99; the release: 0.992)",
     1e-6, 0.999999},
    {0, "halve-every", OPTION_INTEGER, &set.halve_every, "N", "steps after which it is halved (an epoch)", 1,
     1e12},
    {0, "halve-pictures", OPTION_INTEGER, &set.halve_pictures, "N",
     "the same by target pictures, over all steps (the release: 16000)", 1, 1e12},
    {0, "last-weights", OPTION_FLAG, &set.last_weights, NULL,
     "model.safetensors has the last step's weights, as the release evaluates, not their moving average"},
    {0, "sample-every", OPTION_INTEGER, &set.sample_every, "N", "steps between sample pictures (500)", 1,
     1e12},
    {0, "save-every", OPTION_INTEGER, &set.save_every, "N", "steps between checkpoints (500)", 1, 1e12},
    {0, "workers", OPTION_INTEGER, &set.workers, "N", "threads that load pictures (2)", 1, 256},
    {0},
};

static int run(session *s, int count, char **argument) {
    const char *body = session_body(s, set.body, set.data);
    if (!body) return EXIT_USAGE;
    const char *networks = set.estimated > 0 ? photo_networks() : session_asset(NULL, PHOTO_NETWORKS);
    if (set.estimated > 0 && !networks) return EXIT_FAILED;
    sherf_train_options o = {.data = set.data,
                             .people = set.people,
                             .body = body,
                             .output = set.output,
                             .preset = set.preset,
                             .resnet = set.resnet,
                             .lpips = set.lpips,
                             .perceptual = session_perceptual(set.perceptual),
                             .perceptual_weight = set.perceptual_weight,
                             .resume = set.resume,
                             .start = set.start,
                             .estimated = set.estimated,
                             .estimator = networks,
                             .front_view = set.front_view,
                             .size_px = (int)set.size,
                             .epochs = set.epochs,
                             .steps = set.steps,
                             .seconds = set.seconds,
                             .batch = (int)set.batch,
                             .targets = (int)set.targets,
                             .pictures = (int)set.pictures,
                             .learning_rate = set.learning_rate,
                             .halve_every = set.halve_every,
                             .halve_pictures = set.halve_pictures,
                             .last_weights = set.last_weights,
                             .beta2 = set.beta2,
                             .sample_every = set.sample_every,
                             .save_every = set.save_every,
                             .seed = (uint64_t)common.seed,
                             .workers = (int)set.workers,
                             .background = set.background,
                             .without = set.without};
    int status = session_status(s, sherf_train(s->context, &o));
    if (status) return status;
    if (common.json && !common.silent) {
        cJSON *json = cJSON_CreateObject();
        char path[4096];
        snprintf(path, sizeof path, "%s/model.safetensors", set.output);
        cJSON_AddStringToObject(json, "model", path);
        session_json(json);
    } else {
        session_remark("%s/model.safetensors: the model; %s/loss.png: the course of its loss", set.output,
                       set.output);
    }
    return EXIT_DONE;
}

const verb verb_train = {
    .name = "train",
    .arguments = "",
    .summary = "train a model on a multi-view data set",
    .description =
        "Trains the network: colour, mask, SSIM and (given --lpips) LPIPS or else the resnet50 distance as "
        "losses, Adam, a rate halved every "
        "epoch, a moving average of the weights. Ctrl-C saves a checkpoint; the same command goes on from "
        "it, "
        "with the same result as if it had not stopped. Under mpirun the samples of a step are shared out.",
    .example =
        "sherf train --data thuman:people --people 0-2 --body people/tubeman.safetensors --preset small "
        "--size 256 --seconds 300 -o run\n"
        "mpirun -n 4 sherf train --data zju:CoreView --body body.safetensors -o run",
    .options = options,
    .arguments_min = 0,
    .arguments_max = 0,
    .computes = true,
    .run = run,
};
