/* The methods that are compared, and how they are trained. Recipes are `matched`, which isolates the
 * architecture, except those marked own: PIFu has no other. The ablation's rows are the release's switches:
 * without the transformer, concatenation and projection stay. */
#include <string.h>

#include "experiment/experiment.h"

#define SHERF(settings)                                                                                      \
    .preset = {"small,encoder_width=8,style_width=16,plane_resolution=16,channel_base=256,channel_max=16,"   \
               "volume_channels0=8,volume_channels1=8,volume_channels2=8,decoder_width=16,decoder_depth=2,"  \
               "decoder_skip=0,view_width=16,voxel_size_m=0.05,samples=12" settings,                         \
               "small" settings, "paper" settings},                                                          \
    .resnet = {0, 18, 18}
#define PIXELNERF(recipe)                                                                                    \
    .preset = {"pixelnerf:" recipe "-small,encoder_width=8,width=16,samples=12",                             \
               "pixelnerf:" recipe "-small", "pixelnerf:" recipe},                                           \
    .resnet = {0, 18, 34}, .rate = 5e-4, .one_pose = true
#define NHP(recipe)                                                                                          \
    .preset = {"nhp:" recipe "-small,encoder_width=8,width=16,volume_channels0=8,volume_channels1=8,"        \
               "volume_channels2=8,volume_channels3=8,voxel_size_m=0.05,samples=12",                         \
               "nhp:" recipe "-small", "nhp:" recipe},                                                       \
    .resnet = {0, 18, 18}, .rate = 5e-4
#define MPS_NERF(recipe)                                                                                     \
    .preset = {"mps-nerf:" recipe                                                                            \
               "-small,encoder_width=8,value_width=24,mlp_width=16,width=16,view_width=8,"                   \
               "samples=12",                                                                                 \
               "mps-nerf:" recipe "-small", "mps-nerf:" recipe},                                             \
    .resnet = {0, 18, 34}, .rate = 5e-4
/* For quick: a network half the size of own-small. In a few minutes a CPU trains it for some thousand steps.
 */
#define PIFU                                                                                                 \
    .preset = {"pifu:own-small,stacks=1,width=16,color_width=4,hidden0=16,hidden1=8,hidden2=0,side_px=64,"   \
               "points=512,resolution=32,coarse=16,image_size=64",                                           \
               "pifu:own-small,width=64,color_width=16,hidden0=128,hidden1=64,hidden2=32,side_px=128,"       \
               "points=2000,image_size=128",                                                                 \
               "pifu:own"},                                                                                  \
    .own = true, .one_pose = true
static const experiment_method methods[] = {
    {"pixelnerf", "PixelNeRF + shell", PIXELNERF("matched")},
    {"nhp", "NHP", NHP("matched")},
    {"mps-nerf", "MPS-NeRF", MPS_NERF("matched")},
    {"sherf", "SHERF", SHERF("")},
    {"pixelnerf-own", "PixelNeRF, own recipe", PIXELNERF("own"), .own = true, .on_request = true},
    {"nhp-own", "NHP, own recipe", NHP("own"), .own = true, .on_request = true},
    {"mps-nerf-own", "MPS-NeRF, own recipe", MPS_NERF("own"), .own = true, .on_request = true},
    {"pifu", "PIFu", PIFU},
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

const experiment_method *experiment_method_at(int i) {
    return i >= 0 && i < (int)COUNT_OF(methods) ? &methods[i] : NULL;
}
