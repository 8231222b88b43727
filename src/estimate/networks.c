/* BlazePose's two graphs out of one safetensors file, refused unless inputs and outputs have the sizes that
 * are counted on. */
#include <string.h>

#include "estimate/graph_file.h"
#include "estimate/networks.h"

static const char *const detector_outputs[] = {"person"};
static const char *const landmark_outputs[LANDMARKS_OUTPUTS] = {"ld_3d", "world_3d",
                                                                "activation_segmentation", "output_poseflag"};

void pose_networks_free(pose_networks *n) {
    if (!n) return;
    graph_free(n->detector);
    graph_free(n->landmarks);
    mem_free(n);
}

static bool output_is(const graph *g, int i, int rank, const int64_t *want) {
    int64_t size[GRAPH_RANK];
    return graph_output_size(g, i, size) == rank && !memcmp(size, want, (size_t)rank * sizeof *want);
}

/* The graphs have the sizes that their users count on. */
static bool sizes_fit(const pose_networks *n) {
    const int64_t person[] = {DETECTOR_ROWS, DETECTOR_COLUMNS}, one[] = {1},
                  places[] = {LANDMARKS_IN_FILE * LANDMARK_COLUMNS}, world[] = {LANDMARKS_IN_FILE * 3},
                  mask[] = {LANDMARKS_SIDE, LANDMARKS_SIDE, 1}, photo[] = {DETECTOR_SIDE, DETECTOR_SIDE, 3},
                  region[] = {LANDMARKS_SIDE, LANDMARKS_SIDE, 3};
    return graph_input_is(n->detector, 3, photo) && output_is(n->detector, 0, 2, person) &&
           graph_input_is(n->landmarks, 3, region) && output_is(n->landmarks, LANDMARKS_PICTURE, 1, places) &&
           output_is(n->landmarks, LANDMARKS_WORLD, 1, world) &&
           output_is(n->landmarks, LANDMARKS_MASK, 3, mask) &&
           output_is(n->landmarks, LANDMARKS_FLAG, 1, one);
}

sherf_status pose_networks_load(context *c, const char *path, pose_networks **out) {
    safetensors *file;
    *out = NULL;
    sherf_status status = safetensors_read(c, path, &file);
    if (status != SHERF_OK) return status;
    pose_networks *n = mem_zero(c, 1, sizeof *n);
    status =
        n ? graph_read(c, file, "blazepose-detector", 1, detector_outputs, &n->detector) : SHERF_NO_MEMORY;
    if (status == SHERF_OK)
        status = graph_read(c, file, "blazepose-heavy", LANDMARKS_OUTPUTS, landmark_outputs, &n->landmarks);
    if (status == SHERF_OK && !sizes_fit(n))
        status = failure(c, SHERF_MISMATCH, "its networks have other sizes than BlazePose's");
    safetensors_free(file);
    if (status == SHERF_OK) {
        *out = n;
        return status;
    }
    pose_networks_free(n);
    return failure_prefix(c, status, "%s", path);
}
