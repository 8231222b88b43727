/* ZJU-MoCap: the reader of its layout, and the paper's protocol on it. */
#include <string.h>

#include "data/annots.h"

static const char *const training_people[] = {"CoreView_386", "CoreView_387", "CoreView_390",
                                              "CoreView_392", "CoreView_393", "CoreView_394"};
static const char *const test_people[] = {"CoreView_377", "CoreView_313", "CoreView_315"};

static bool recognise(const char *folder) {
    return annots_are_in(folder) && !path_has(folder, "new_params_neutral");
}

static sherf_status record(context *c, const char *folder, person_record *r) {
    return annots_read(c, folder, 1e-3, r); /* T is in millimetres */
}

static sherf_status pose_files(context *c, const person_record *r, const char *folder, int pose,
                               char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]) {
    static const char *const kinds[] = {"new_params", NULL};
    return annots_pose_files(c, r, folder, kinds, pose, parameters, vertices);
}

static void split(context *c, const sherf_dataset *d, bool training, int *index, int *count) {
    const char *const *names = training ? training_people : test_people;
    size_t n = training ? COUNT_OF(training_people) : COUNT_OF(test_people);
    for (size_t i = 0; i < n; i++) {
        int person = dataset_find(d, names[i], strlen(names[i]));
        if (person >= 0)
            index[(*count)++] = person;
        else
            log_line(c, SHERF_LOG_WARNING, "%s: %s of the paper's split is not there", d->root, names[i]);
    }
}

const dataset_reader dataset_zju_mocap = {
    .protocol = {.name = "zju",
                 .train_first = -1,
                 .train_count = -1,
                 .test_first = -1,
                 .test_count = -1,
                 .train_poses = 100,
                 .train_pose_step = 5,
                 .views = 20,
                 .view_step = 2,
                 .observation_views = {4, 10, 16},
                 .pose_first = 0,
                 .pose_step = 20,
                 .pose_count = 25,
                 .observation_pose = 0,
                 .front_view = 10,
                 .image_scale = 0.5},
    .recognise = recognise,
    .record = record,
    .picture = annots_picture,
    .pose_files = pose_files,
    .pose_keys = {{"poses", "pose"}, {"shapes", "betas"}, {"Rh", "R"}, {"Th", "Th"}},
    .pose_needs = "poses, shapes, R (or Rh) and Th",
    .edge_band = true,
    .split = split,
};
