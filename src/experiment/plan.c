/* The paper's experiments: which methods, trained on what, scored how. */
#include <string.h>

#include "experiment/experiment.h"

/* ---- methods ----
 * `matched` recipes, which isolate the architecture, but for those marked own. The rows of the ablation are
 * the release's switches: without the transformer concatenation and projection stay. */
#define SHERF(settings)                                                                                      \
    .preset = {"small,encoder_width=8,style_width=16,plane_resolution=16,channel_base=256,channel_max=16,"   \
               "volume_channels0=8,volume_channels1=8,volume_channels2=8,decoder_width=16,decoder_depth=2,"  \
               "decoder_skip=0,view_width=16,voxel_size_m=0.05,samples=12" settings,                         \
               "small" settings, "paper" settings},                                                          \
    .resnet = {0, 18, 18}
#define PIXELNERF(recipe)                                                                                    \
    .preset = {"pixelnerf:" recipe "-small,encoder_width=8,width=16,samples=12",                             \
               "pixelnerf:" recipe "-small", "pixelnerf:" recipe},                                           \
    .resnet = {0, 18, 34}, .one_pose = true
#define NHP(recipe)                                                                                          \
    .preset = {"nhp:" recipe "-small,encoder_width=8,width=16,volume_channels0=8,volume_channels1=8,"        \
               "volume_channels2=8,volume_channels3=8,voxel_size_m=0.05,samples=12",                         \
               "nhp:" recipe "-small", "nhp:" recipe},                                                       \
    .resnet = {0, 18, 18}
#define MPS_NERF(recipe)                                                                                     \
    .preset = {"mps-nerf:" recipe                                                                            \
               "-small,encoder_width=8,value_width=24,mlp_width=16,width=16,view_width=8,"                   \
               "samples=12",                                                                                 \
               "mps-nerf:" recipe "-small", "mps-nerf:" recipe},                                             \
    .resnet = {0, 18, 34}
static const experiment_method methods[] = {
    {"pixelnerf", "PixelNeRF + shell", PIXELNERF("matched")},
    {"nhp", "NHP", NHP("matched")},
    {"mps-nerf", "MPS-NeRF", MPS_NERF("matched")},
    {"sherf", "SHERF", SHERF("")},
    {"pixelnerf-own", "PixelNeRF, own recipe", PIXELNERF("own"), .own = true},
    {"nhp-own", "NHP, own recipe", NHP("own"), .own = true},
    {"mps-nerf-own", "MPS-NeRF, own recipe", MPS_NERF("own"), .own = true},
    {"nhp-front", "NHP", NHP("matched"), .front_view = true},
    {"mps-nerf-front", "MPS-NeRF", MPS_NERF("matched"), .front_view = true},
    {"sherf-front", "SHERF", SHERF(""), .front_view = true},
    {"sherf-g", "global", SHERF(",use_point=0,use_pixel=0,fusion=1"), .steps_of = "sherf"},
    {"sherf-gp", "global, point", SHERF(",use_pixel=0,fusion=1"), .steps_of = "sherf"},
    {"sherf-gx", "global, pixel", SHERF(",use_point=0,fusion=1"), .steps_of = "sherf"},
    {"sherf-px", "point, pixel", SHERF(",use_global=0,fusion=1"), .steps_of = "sherf"},
    {"sherf-gpx", "global, point, pixel: concatenation", SHERF(",fusion=1"), .steps_of = "sherf"},
    {"sherf-fair", "the same, every token read", SHERF(",fusion=2"), .steps_of = "sherf"},
    {"sherf-adain", "AdaIN", SHERF(",fusion=3"), .steps_of = "sherf"},
    {"sherf-siren", "SIREN", SHERF(",fusion=4"), .steps_of = "sherf"},
    {"sherf-no-color", "without colour", SHERF(""), .without = "color", .steps_of = "sherf"},
    {"sherf-no-mask", "without mask", SHERF(""), .without = "mask", .steps_of = "sherf"},
    {"sherf-no-ssim", "without SSIM", SHERF(""), .without = "ssim", .steps_of = "sherf"},
    {"sherf-no-perceptual", "without LPIPS or resnet50", SHERF(""), .without = "perceptual",
     .steps_of = "sherf"},
    {"sherf-film", "SIREN, low frequencies", SHERF(",fusion=5"), .steps_of = "sherf"},
};

const experiment_method *experiment_method_find(const char *key) {
    for (size_t i = 0; i < COUNT_OF(methods); i++)
        if (!strcmp(methods[i].key, key)) return &methods[i];
    return NULL;
}

/* ---- experiments ---- */
#define LOOK                                                                                                 \
    {SCORING_VIEWS}, {                                                                                       \
        SCORING_POSES                                                                                        \
    }
static const experiment experiments[] = {
    {"main",
     "Main table: novel view and novel pose",
     report_scores,
     {"pixelnerf", "nhp", "mps-nerf", "sherf", "pixelnerf-own", "nhp-own", "mps-nerf-own"},
     3,
     {{SCORING_PROTOCOL}, LOOK},
     .all_seeds = true,
     .all_data = true},
    {"ablation",
     "Ablation of the features",
     report_scores,
     {"sherf-g", "sherf-gp", "sherf-gx", "sherf-px", "sherf-gpx", "sherf"},
     3,
     {{SCORING_PROTOCOL}, LOOK},
     .note = "Rows but the last are without the transformer, by the release's switches: concatenation and "
             "projection "
             "stay, and the decoder reads tokens 0 and 1. All take SHERF's number of steps; they run op by "
             "op, so "
             "these take longer."},
    {"fusion",
     "Fusion of the features",
     report_scores,
     {"sherf-gpx", "sherf-fair", "sherf-adain", "sherf-siren", "sherf-film", "sherf"},
     3,
     {{SCORING_PROTOCOL}, LOOK},
     .note =
         "SHERF has the transformer. Without it the release's decoder never reads token 2; in the other "
         "rows a linear layer of all three tokens gives what it reads. Of AdaIN and SIREN the paper tells "
         "the names alone; these are definitions of our own (docs/experiments.md): the global feature is "
         "the style of the other two. Frequencies of 30 suit coordinates in [-1, 1], which features are "
         "not: the row of low frequencies tells what that costs."},
    {"losses",
     "Without each loss",
     report_scores,
     {"sherf-no-color", "sherf-no-mask", "sherf-no-ssim", "sherf-no-perceptual", "sherf"},
     3,
     {{SCORING_PROTOCOL}, LOOK},
     .note =
         "Each row is trained without one of the four terms; SSIM and the distances are scores as well as "
         "terms, so a row without one is not told by that column alone. Where neither LPIPS's weights "
         "nor resnet50's were given, the fourth row is SHERF itself."},
    {"front-view",
     "Trained on front views",
     report_front,
     {"nhp-front", "mps-nerf-front", "sherf-front"},
     4,
     {{SCORING_FRONT}, {SCORING_PROTOCOL}, LOOK}},
    {"input-angle",
     "Twelve input angles",
     report_input_angle,
     {"nhp", "mps-nerf", "sherf"},
     1,
     {{SCORING_ANGLES}}},
    {"angle-difference",
     "Difference of the viewing angles",
     report_angle_difference,
     {"nhp", "mps-nerf", "sherf"},
     1,
     {{SCORING_ANGLES}}},
    {"cross-data",
     "Other data than it was trained on",
     report_cross,
     {"nhp", "mps-nerf", "sherf"},
     1,
     {{SCORING_PROTOCOL, .crossed = true}},
     .both_ways = true},
    {"estimated-body",
     "Estimated bodies and cameras",
     report_estimated,
     {"nhp", "mps-nerf", "sherf"},
     5,
     {{SCORING_PROTOCOL},
      {SCORING_ESTIMATED},
      {SCORING_DISTURBED, 20},
      {SCORING_DISTURBED, 43},
      {SCORING_DISTURBED, 70}}},
    {"runtime", "Time", report_runtime, {"pixelnerf", "nhp", "mps-nerf", "sherf"}},
    {"preference",
     "Preference: a study",
     report_preference,
     {"nhp", "mps-nerf", "sherf"},
     1,
     {{SCORING_STUDY}}},
    {"pifu", "PIFu", NULL, .lacks = "the model pifu"},
};

const experiment *experiment_at(int i) {
    return i >= 0 && i < (int)COUNT_OF(experiments) ? &experiments[i] : NULL;
}

const experiment *experiment_find(const char *name) {
    for (int i = 0; name && experiment_at(i); i++)
        if (!strcmp(experiments[i].name, name)) return &experiments[i];
    return NULL;
}
