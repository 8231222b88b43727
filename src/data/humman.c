/* HuMMan: the reader of its layout, and the paper's protocol on it. */
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/dataset.h"

static bool recognise(const char *folder) {
    return path_has(folder, "cameras.json") && path_has(folder, "kinect_color");
}

/* The frame's number in 000012.npz, or -1. */
static int frame_number(const char *name) {
    size_t digits = strspn(name, "0123456789");
    if (digits != 6 || strcmp(name + digits, ".npz") != 0) return -1;
    return (int)strtol(name, NULL, 10);
}

/* Poses are the numbers of the files in smpl_params; releases that keep every sixth frame have gaps. */
static sherf_status poses_find(context *c, const char *folder, person_record *r) {
    char path[PATH_LENGTH];
    sherf_status status = path_join(c, path, sizeof path, folder, "smpl_params");
    if (status) return status;
    for (int pass = 0; pass < 2; pass++) {
        DIR *dir = opendir(path);
        if (!dir) return failure(c, SHERF_NO_FILE, "%s: cannot be opened", path);
        for (struct dirent *e; (e = readdir(dir));) {
            int n = frame_number(e->d_name);
            if (n < 0) continue;
            if (pass && n < r->poses)
                r->present[n] = true;
            else if (!pass && n + 1 > r->poses)
                r->poses = n + 1;
        }
        closedir(dir);
        if (!r->poses) return failure(c, SHERF_BAD_FILE, "%s: no files like 000000.npz", path);
        if (!pass && !(r->present = mem_zero(c, (size_t)r->poses, sizeof *r->present)))
            return SHERF_NO_MEMORY;
    }
    return SHERF_OK;
}

static sherf_status record(context *c, const char *folder, person_record *r) {
    sherf_status status = cameras_json_read(c, folder, "kinect_color_", 3, r);
    return status ? status : poses_find(c, folder, r);
}

static sherf_status present_check(context *c, const person_record *r, const char *folder, int pose) {
    if (r->present[pose]) return SHERF_OK;
    return failure(c, SHERF_NO_FILE, "%s: no smpl_params/%06d.npz", folder, pose);
}

static sherf_status picture(context *c, const person_record *r, const char *folder, int pose, int view,
                            char image[PATH_LENGTH], char mask[PATH_LENGTH]) {
    char name[64];
    snprintf(name, sizeof name, "kinect_color/kinect_%03d/%06d.png", view, pose);
    sherf_status status = present_check(c, r, folder, pose);
    if (!status) status = path_join(c, image, PATH_LENGTH, folder, name);
    snprintf(name, sizeof name, "kinect_mask/kinect_%03d/%06d.png", view, pose);
    return status ? status : path_join(c, mask, PATH_LENGTH, folder, name);
}

static sherf_status pose_files(context *c, const person_record *r, const char *folder, int pose,
                               char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]) {
    char name[64];
    vertices[0] = 0;
    snprintf(name, sizeof name, "smpl_params/%06d.npz", pose);
    sherf_status status = present_check(c, r, folder, pose);
    return status ? status : path_join(c, parameters, PATH_LENGTH, folder, name);
}

/* The official test list; all others are for training. */
static const char *const tested[] = {
    "p000455_a000986", "p000456_a000396", "p000465_a000048", "p000465_a000701", "p000474_a000048",
    "p000477_a000396", "p000482_a000793", "p000491_a005730", "p000503_a000064", "p000503_a000224",
    "p000532_a005711", "p000538_a000978", "p000538_a000986", "p000542_a000048", "p000545_a000064",
    "p000547_a000011", "p000547_a000145", "p000557_a000793", "p000582_a000048", "p100050_a001425",
    "p100056_a000049", "p100074_a000048"};

static bool is_tested(const char *name) {
    for (size_t i = 0; i < COUNT_OF(tested); i++)
        if (!strcmp(tested[i], name)) return true;
    return false;
}

/* Without train.txt and test.txt. */
static void split(context *c, const sherf_dataset *d, bool training, int *index, int *count) {
    for (int i = 0; i < d->people; i++)
        if (is_tested(d->name[i]) != training) index[(*count)++] = i;
    if (!training && *count && *count < (int)COUNT_OF(tested))
        log_line(c, SHERF_LOG_WARNING, "%s: %d of the %d sequences of HuMMan's test list", d->root, *count,
                 (int)COUNT_OF(tested));
}

const dataset_reader dataset_humman = {
    .protocol = {.name = "humman",
                 .train_first = -1,
                 .train_count = -1,
                 .test_first = -1,
                 .test_count = -1,
                 .train_poses = 17,
                 .train_pose_step = 6,
                 .views = 10,
                 .view_step = 1,
                 .observation_views = {0, 4, 8},
                 .pose_first = 0,
                 .pose_step = 6,
                 .pose_count = 17,
                 .observation_pose = 0,
                 .front_view = 0,
                 .image_scale = 1. / 3},
    .recognise = recognise,
    .record = record,
    .picture = picture,
    .pose_files = pose_files,
    .pose_keys = {{"body_pose", "body_pose"},
                  {"betas", "betas"},
                  {"global_orient", "global_orient"},
                  {"transl", "transl"}},
    .pose_needs = "betas, global_orient, body_pose and transl",
    .split = split,
};
