/* sherf eval: compares novel views and novel poses of a data set's people with the truth, by the paper's
 * protocol unless options say otherwise. */
#include "photo.h"
#include "shared.h"
#include "verbs.h"

static struct {
    const char *data, *people, *model, *body, *lpips, *perceptual, *observation, *poses, *views, *output,
        *sheet;
    bool baked, surfaces, npy, no_png, baselines, detail, estimated, own_pose, batch_statistics, round_psnr;
    int64_t size, samples, pictures, variant;
} set = {.samples = SHERF_SAMPLES_MODEL, .pictures = 1};

static const option options[] = {
    SHARED_DATA(&set.data),
    {'P', "people", OPTION_TEXT, &set.people, "LIST",
     "names, or a range 90-99 of the data set's list (the paper's test people)"},
    SHARED_WEIGHTS(&set.model),
    SHARED_BODY_OF_DATA(&set.body),
    {0, "observation", OPTION_PAIRS, &set.observation, "POSE:VIEW,...",
     "the observed pictures; each is evaluated; 'random': one for each person, by --seed (the paper's)"},
    {0, "pictures", OPTION_INTEGER, &set.pictures, "N",
     "pictures of each observation, in its pose: itself, and others from views evenly round the person, "
     "which "
     "are left out of the targets (1, the paper's)",
     1, SHERF_PICTURES_MAX},
    {0, "baked", OPTION_FLAG, &set.baked, NULL,
     "bake each avatar (sherf bake) and score its frames in place of the network's"},
    {0, "surfaces", OPTION_FLAG, &set.surfaces, NULL,
     "also compare the surface that each avatar would be baked to with the data set's, where it has them"},
    {0, "poses", OPTION_LIST, &set.poses, "LIST", "target poses: 0,2 or first:step:count (the paper's)"},
    {0, "views", OPTION_LIST, &set.views, "LIST", "target views (the paper's)"},
    SHARED_LPIPS(&set.lpips, "; without it no LPIPS"),
    SHARED_PERCEPTUAL(&set.perceptual, "the resnet50 distance", "none"),
    {0, "baselines", OPTION_FLAG, &set.baselines, NULL,
     "also score the mean colour in the true mask, and the body painted with the picture"},
    {0, "estimated", OPTION_FLAG, &set.estimated, NULL,
     "estimate cameras, bodies and masks of the observations from their pictures alone, and report the "
     "errors"},
    {0, "own-pose", OPTION_FLAG, &set.own_pose, NULL,
     "with --estimated: novel views in the pose that was estimated, not the true one"},
    SHARED_WIDTH(&set.size, 4096),
    {0, "samples", OPTION_INTEGER, &set.samples, "N",
     "depths on every ray; 0: as sherf render, 12 mm a step at most (the model's, as in the paper)", 0, 1024},
    {0, "detail", OPTION_FLAG, &set.detail, NULL,
     "add the observed picture's detail to the frames and clear their haze, unlike the paper"},
    {0, "variant", OPTION_INTEGER, &set.variant, "N",
     "with --detail, avatars' unseen sides are this variant (sherf avatar --variant), not the best guess", 0,
     1e9},
    {0, "batch-statistics", OPTION_FLAG, &set.batch_statistics, NULL,
     "batch norms take the observed picture's own statistics, as the paper's release does"},
    {0, "round-psnr", OPTION_FLAG, &set.round_psnr, NULL,
     "round a picture's PSNR to three decimals before the means, as the release does"},
    {'o', "output", OPTION_FILE, &set.output, "FOLDER", "scores.json and predictions beside the truth"},
    {0, "npy", OPTION_FLAG, &set.npy, NULL, "predictions also as H x W x 3 float32 .npy"},
    {0, "sheet", OPTION_FILE, &set.sheet, "PNG",
     "one picture of everything: for each observation a row with it and four pairs of prediction and truth"},
    {0, "no-png", OPTION_FLAG, &set.no_png, NULL, "no pictures"},
    {0},
};

static void score_add(cJSON *json, const char *name, const sherf_score *score) {
    cJSON *o = cJSON_AddObjectToObject(json, name);
    cJSON_AddNumberToObject(o, "psnr", score->psnr);
    cJSON_AddNumberToObject(o, "ssim", score->ssim);
    cJSON_AddNumberToObject(o, "lpips", score->lpips); /* NaN is written as null */
    cJSON_AddNumberToObject(o, "resnet50", score->resnet50);
    cJSON_AddNumberToObject(o, "count", score->count);
}

static void baseline_add(cJSON *json, const char *name, const sherf_score score[2]) {
    if (!score[0].count && !score[1].count) return;
    cJSON *o = cJSON_AddObjectToObject(json, name);
    score_add(o, "novel_view", &score[0]);
    score_add(o, "novel_pose", &score[1]);
}

static void surfaces_add(cJSON *json, const sherf_surface_scores *f) {
    if (!f->count && !f->missed) return;
    cJSON *o = cJSON_AddObjectToObject(json, "surfaces");
    cJSON_AddNumberToObject(o, "count", f->count);
    cJSON_AddNumberToObject(o, "missed", f->missed);
    if (!f->count) return;
    cJSON_AddNumberToObject(o, "chamfer_cm", f->chamfer_cm);
    cJSON_AddNumberToObject(o, "to_truth_cm", f->to_truth_cm);
    cJSON_AddNumberToObject(o, "from_truth_cm", f->from_truth_cm);
    cJSON_AddNumberToObject(o, "normal_deg", f->normal_deg);
    cJSON_AddNumberToObject(o, "overlap", f->overlap);
}

static void estimates_add(cJSON *json, const sherf_estimate_scores *e) {
    if (!e->count && !e->missed) return;
    cJSON *o = cJSON_AddObjectToObject(json, "estimates");
    cJSON_AddNumberToObject(o, "joints_mm", e->joints_mm);
    cJSON_AddNumberToObject(o, "aligned_mm", e->aligned_mm);
    cJSON_AddNumberToObject(o, "lean_deg", e->lean_deg);
    cJSON_AddNumberToObject(o, "forward_deg", e->forward_deg);
    cJSON_AddNumberToObject(o, "turn_deg", e->turn_deg);
    cJSON_AddNumberToObject(o, "overlap", e->overlap);
    cJSON_AddNumberToObject(o, "overlap_min", e->overlap_min);
    cJSON_AddNumberToObject(o, "wrong_way", e->wrong_way);
    cJSON_AddNumberToObject(o, "count", e->count);
    cJSON_AddNumberToObject(o, "missed", e->missed);
}

static int run(session *s, int count, char **argument) {
    if (set.own_pose && !set.estimated) return usage_error(s->verb_name, "--own-pose needs --estimated");
    if (set.variant && !set.detail) return usage_error(s->verb_name, "--variant needs --detail");
    if (set.npy && !set.output) return usage_error(s->verb_name, "--npy needs --output");
    const char *body = session_body(s, set.body, set.data);
    const char *model = body ? session_model(s, set.model) : NULL;
    if (!model) return EXIT_USAGE;
    const char *networks = set.estimated ? photo_networks() : NULL;
    if (set.estimated && !networks) return EXIT_FAILED;
    sherf_eval_options o = {.data = set.data,
                            .people = set.people,
                            .body = body,
                            .model = model,
                            .lpips = set.lpips,
                            .perceptual = session_perceptual(set.perceptual),
                            .baselines = set.baselines,
                            .estimated = networks,
                            .own_pose = set.own_pose,
                            .batch_statistics = set.batch_statistics,
                            .round_psnr = set.round_psnr,
                            .pictures = (int)set.pictures,
                            .baked = set.baked,
                            .surfaces = set.surfaces,
                            .variant = (uint64_t)set.variant,
                            .samples = set.samples ? (int)set.samples : SHERF_SAMPLES_AUTO,
                            .detail = set.detail ? SHERF_DETAIL_ON : SHERF_DETAIL_OFF,
                            .size_px = (int)set.size,
                            .seed = (uint64_t)common.seed,
                            .observations = set.observation,
                            .poses = set.poses,
                            .views = set.views,
                            .output = set.output,
                            .sheet = set.sheet,
                            .write_png = set.output && !set.no_png,
                            .write_npy = set.npy,
                            .precision = (sherf_precision)common.precision};
    sherf_scores scores = {0};
    int status = session_status(s, sherf_eval(s->context, &o, &scores));
    if (!status && common.json) {
        cJSON *json = cJSON_CreateObject();
        score_add(json, "novel_view", &scores.novel_view);
        score_add(json, "novel_pose", &scores.novel_pose);
        baseline_add(json, "mean_color", scores.mean_color);
        baseline_add(json, "painted_body", scores.painted_body);
        estimates_add(json, &scores.estimates);
        surfaces_add(json, &scores.surfaces);
        session_json(json);
    } else if (!status && scores.table) {
        fputs(scores.table, stdout);
    }
    sherf_free(scores.table);
    return status;
}

const verb verb_eval = {
    .name = "eval",
    .arguments = "",
    .summary = "score a model on a data set: PSNR, SSIM, LPIPS, resnet50",
    .description =
        "Renders people of a data set from one picture each and compares with the truth, by the paper's "
        "protocol: novel view (the observation's pose) and novel pose (others). The observed view itself is "
        "left out. Scores are printed by person with their means and go to OUT/scores.json. They are "
        "computed in float32 unless --precision bf16 is given.",
    .example =
        "sherf eval --data thuman:THuman/nerf_data_ --model model.safetensors --body body.safetensors -o "
        "out\n"
        "sherf eval --data thuman:people --people tube_003 --observation 0:4 --poses 0,2 --views 0:2:12 "
        "-m model.safetensors -b people/tubeman.safetensors\n"
        "sherf eval --data thuman:people --people 0-9 --observation random --seed 1 --size 256 --baselines "
        "-m "
        "model.safetensors -b body.safetensors -o out",
    .options = options,
    .arguments_min = 0,
    .arguments_max = 0,
    .computes = true,
    .run = run,
};
