/* networks: BlazePose's two, as assets/models/blazepose.safetensors has them: one finds people in a picture,
 * one their landmarks in a region (docs/photo.md). */
#ifndef SHERF_ESTIMATE_NETWORKS_H
#define SHERF_ESTIMATE_NETWORKS_H

#include "nn/graph.h"

enum { DETECTOR_SIDE = 224, DETECTOR_ROWS = 2254, DETECTOR_COLUMNS = 13 };
enum { LANDMARKS_SIDE = 256, LANDMARKS_IN_FILE = 39, LANDMARK_COLUMNS = 5 };
/* Outputs of the network of landmarks. */
enum { LANDMARKS_PICTURE, LANDMARKS_WORLD, LANDMARKS_MASK, LANDMARKS_FLAG, LANDMARKS_OUTPUTS };

typedef struct {
    graph *detector;  /* [224, 224, 3] in [-1, 1] to [2254, 13] */
    graph *landmarks; /* [256, 256, 3] in [0, 1] to [39 * 5], [39 * 3], [256, 256, 1], [1] */
} pose_networks;

sherf_status pose_networks_load(context *c, const char *path, pose_networks **out);
void pose_networks_free(pose_networks *n);
#endif
