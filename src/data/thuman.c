/* THuman: the reader of its layout, and the paper's protocol on it. */
#include "data/annots.h"

static bool recognise(const char *folder) {
    return annots_are_in(folder) && path_has(folder, "new_params_neutral");
}

static sherf_status record(context *c, const char *folder, person_record *r) {
    return annots_read(c, folder, 1, r);
}

static sherf_status pose_files(context *c, const person_record *r, const char *folder, int pose,
                               char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]) {
    static const char *const kinds[] = {"new_params_neutral", "new_params", NULL};
    return annots_pose_files(c, r, folder, kinds, pose, parameters, vertices);
}

const dataset_reader dataset_thuman = {
    .protocol = {.name = "thuman",
                 .train_first = 0,
                 .train_count = 90,
                 .test_first = 90,
                 .test_count = 10,
                 .train_poses = 20,
                 .train_pose_step = 1,
                 .views = 24,
                 .view_step = 2,
                 .observation_views = {4, 12, 20},
                 .pose_first = 0,
                 .pose_step = 2,
                 .pose_count = 5,
                 .observation_pose = 0,
                 .front_view = 12,
                 .image_scale = 1},
    .recognise = recognise,
    .record = record,
    .picture = annots_picture,
    .pose_files = pose_files,
    .pose_keys = {{"poses", "pose"}, {"shapes", "betas"}, {"R", "Rh"}, {"Th", "Th"}},
    .pose_needs = "poses, shapes, R (or Rh) and Th",
};
