/* resnet50_file: the weights of the perceptual distance from a converted file. */
#ifndef SHERF_RESNET50_FILE_H
#define SHERF_RESNET50_FILE_H

#include "nn/resnet50.h"

/* Tensors NAME.weight and NAME.bias for the names of resnet50_layers. */
sherf_status resnet50_load(context *c, const char *path, resnet50_network **out);

#endif
