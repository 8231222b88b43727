/* The paper's experiments: their methods (methods.c), training data and scorings. */
#include <string.h>

#include "experiment/experiment.h"

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
    {"pifu",
     "PIFu: a surface from one picture",
     report_pifu,
     {"pifu", "sherf"},
     3,
     {{SCORING_PROTOCOL}, {SCORING_SURFACE}, {SCORING_VIEWS}},
     .surfaces = true,
     .note =
         "PIFu learned from the people's surfaces and had no body; SHERF had pictures and bodies. "
         "PIFu shows the observed pose alone, so there are no novel poses. SHERF's surface is the one that "
         "sherf bake makes. "
         "The paper shows PIFu's pictures and gives no numbers. For scale, of other people: the authors "
         "of SiTH measured PIFu on 60 scans of CustomHumans, 2.21 cm from its points to the scan and "
         "2.58 cm back."},
};

const experiment *experiment_at(int i) {
    return i >= 0 && i < (int)COUNT_OF(experiments) ? &experiments[i] : NULL;
}

const experiment *experiment_find(const char *name) {
    for (int i = 0; name && experiment_at(i); i++)
        if (!strcmp(experiments[i].name, name)) return &experiments[i];
    return NULL;
}
