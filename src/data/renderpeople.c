/* RenderPeople: the reader of its layout, and the paper's protocol on it. */
#include <stdio.h>
#include <string.h>

#include "data/dataset.h"

static const char pose_file[] = "outputs_re_fitting/refit_smpl_2nd.npz";

static bool recognise(const char *folder) {
    return path_has(folder, "cameras.json") && path_has(folder, "outputs_re_fitting");
}

/* One file for all poses: {betas (1,10), global_orient (P,3), body_pose (P,69), transl (P,3)}. */
static sherf_status poses_read(context *c, const char *folder, person_record *r) {
    char path[PATH_LENGTH];
    document *d = NULL;
    sherf_status status = path_join(c, path, sizeof path, folder, pose_file);
    if (status || (status = parse_file(c, path, &d, NULL))) return status;
    const value *smpl = value_unwrapped(value_get(d->root, "smpl"));
    const value *root = value_get(smpl, "global_orient"), *body = value_get(smpl, "body_pose"),
                *transl = value_get(smpl, "transl"), *betas = value_get(smpl, "betas");
    int64_t poses = parse_rows(root);
    double joint[69], t[3], orient[3];
    float shapes[10];
    if (!root || !body || !transl || !betas || poses < 1 || poses > DATASET_POSES_MAX ||
        parse_rows(body) != poses || parse_rows(transl) != poses) {
        status = failure(c, SHERF_BAD_FILE,
                         "smpl: betas, and global_orient, body_pose, transl with one row a pose are needed");
        goto done;
    }
    r->pose = mem_zero(c, (size_t)poses, sizeof *r->pose);
    if (!r->pose) {
        status = SHERF_NO_MEMORY;
        goto done;
    }
    r->poses = (int)poses;
    status = parse_prefix(c, betas, "betas", BODY_SHAPES, shapes);
    bool betas_by_pose = poses > 1 && value_numbers(betas) == poses * BODY_SHAPES;
    for (int p = 0; p < r->poses && !status; p++) {
        sherf_pose *pose = &r->pose[p];
        double own[10];
        sherf_pose_identity(pose);
        memcpy(pose->shapes, shapes, sizeof shapes);
        status = parse_row(c, root, (size_t)p, "global_orient", 3, orient);
        if (!status) status = parse_row(c, body, (size_t)p, "body_pose", 69, joint);
        if (!status) status = parse_row(c, transl, (size_t)p, "transl", 3, t);
        if (!status && betas_by_pose) status = parse_row(c, betas, (size_t)p, "betas", 10, own);
        if (status) break;
        for (int i = 0; i < 3; i++) pose->poses_rad[i] = (float)orient[i], pose->Th_m[i] = (float)t[i];
        for (int i = 0; i < 69; i++) pose->poses_rad[3 + i] = (float)joint[i];
        for (int i = 0; i < 10 && betas_by_pose; i++) pose->shapes[i] = (float)own[i];
    }
done:
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

static sherf_status record(context *c, const char *folder, person_record *r) {
    sherf_status status = cameras_json_read(c, folder, "camera", 4, r);
    return status ? status : poses_read(c, folder, r);
}

static sherf_status picture(context *c, const person_record *r, const char *folder, int pose, int view,
                            char image[PATH_LENGTH], char mask[PATH_LENGTH]) {
    char name[64];
    snprintf(name, sizeof name, "img/camera%04d/%04d.jpg", view, pose);
    sherf_status status = path_join(c, image, PATH_LENGTH, folder, name);
    snprintf(name, sizeof name, "mask/camera%04d/%04d.png", view, pose);
    return status ? status : path_join(c, mask, PATH_LENGTH, folder, name);
}

static sherf_status pose_files(context *c, const person_record *r, const char *folder, int pose,
                               char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]) {
    vertices[0] = 0;
    return path_join(c, parameters, PATH_LENGTH, folder, pose_file);
}

const dataset_reader dataset_renderpeople = {
    .protocol = {.name = "renderpeople",
                 .train_first = 0,
                 .train_count = 450,
                 .test_first = 450,
                 .test_count = 30,
                 .train_poses = 10,
                 .train_pose_step = 2,
                 .views = 36,
                 .view_step = 2,
                 .observation_views = {0, 16, 31},
                 .pose_first = 0,
                 .pose_step = 2,
                 .pose_count = 5,
                 .observation_pose = 2,
                 .front_view = 0,
                 .image_scale = 1},
    .recognise = recognise,
    .record = record,
    .picture = picture,
    .pose_files = pose_files,
};
