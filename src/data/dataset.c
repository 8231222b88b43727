/* The four data sets behind one door: people, views, poses. Everything is read when it is asked for; the
 * records of people are kept behind a lock, so that several contexts can share one data set. */
#include <stdio.h>
#include <string.h>

#include "data/dataset.h"

/* design: the paper's splits and protocol. Lines count from 0 here. */
static const data_protocol protocols[DATA_KINDS] = {
    [DATA_THUMAN] = {.name = "thuman",
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
    [DATA_RENDERPEOPLE] = {.name = "renderpeople",
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
    [DATA_ZJU] = {.name = "zju",
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
    [DATA_HUMMAN] = {.name = "humman",
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
};

const data_protocol *data_protocol_of(data_kind kind) {
    return &protocols[kind];
}

data_kind dataset_kind(const sherf_dataset *d) {
    return d->kind;
}

int sherf_dataset_person_count(const sherf_dataset *d) {
    return d->people;
}

const char *sherf_dataset_person(const sherf_dataset *d, int person) {
    return person >= 0 && person < d->people ? d->name[person] : NULL;
}

sherf_status dataset_path(context *c, const sherf_dataset *d, int person, const char *file,
                          char out[PATH_LENGTH]) {
    int n = snprintf(out, PATH_LENGTH, "%s/%s%s%s", d->root, d->name[person], *file ? "/" : "", file);
    if (n > 0 && n < PATH_LENGTH) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "%.200s/%.200s: path too long", d->root, d->name[person]);
}

sherf_status dataset_record(context *c, const sherf_dataset *d, int person, const person_record **out) {
    *out = NULL;
    if (person < 0 || person >= d->people)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: no person %d (it has %d)", d->root, person, d->people);
    sherf_status status = SHERF_OK;
    char folder[PATH_LENGTH];
    pthread_mutex_lock(&d->cache->lock);
    person_record *r = d->cache->record[person];
    if (!r) {
        status = dataset_path(c, d, person, "", folder);
        if (!status && !path_is_folder(folder))
            status = failure(c, SHERF_NO_FILE, "%s: no such folder", folder);
        if (!status && !(r = mem_zero(c, 1, sizeof *r))) status = SHERF_NO_MEMORY;
        if (!status)
            status = d->kind == DATA_THUMAN || d->kind == DATA_ZJU
                         ? record_read_annots(c, d->kind, folder, r)
                         : record_read_cameras_json(c, d->kind, folder, r);
        if (status) {
            record_free(r);
            r = NULL;
        }
        d->cache->record[person] = r;
    }
    pthread_mutex_unlock(&d->cache->lock);
    *out = r;
    return status;
}

static const person_record *record_quietly(const sherf_dataset *d, int person) {
    context quiet = {.threads = 1};
    const person_record *r;
    dataset_record(&quiet, d, person, &r);
    return r;
}

int sherf_dataset_pose_count(const sherf_dataset *d, int person) {
    const person_record *r = record_quietly(d, person);
    return r ? r->poses : 0;
}

int sherf_dataset_view_count(const sherf_dataset *d, int person) {
    const person_record *r = record_quietly(d, person);
    return r ? r->views : 0;
}

static sherf_status record_at(context *c, const sherf_dataset *d, int person, int pose, int view,
                              const person_record **out) {
    sherf_status status = dataset_record(c, d, person, out);
    if (status) return status;
    const person_record *r = *out;
    if (pose < 0 || pose >= r->poses)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: no pose %d (it has %d)", d->name[person], pose, r->poses);
    if (view < 0 || view >= r->views)
        return failure(c, SHERF_BAD_ARGUMENT, "%s: no view %d (it has %d)", d->name[person], view, r->views);
    if (r->present && !r->present[pose])
        return failure(c, SHERF_NO_FILE, "%s: no smpl_params/%06d.npz", d->name[person], pose);
    return SHERF_OK;
}

/* The mask that belongs to a picture of annots.npy: mask_cihp/<path>.png, or mask/<path>.png. */
static sherf_status annots_mask(context *c, const sherf_dataset *d, int person, const char *image,
                                char out[PATH_LENGTH]) {
    char other[PATH_LENGTH];
    const char *name = strrchr(image, '/'), *dot = strrchr(image, '.');
    int stem = dot && (!name || dot > name) ? (int)(dot - image) : (int)strlen(image);
    int n = snprintf(out, PATH_LENGTH, "%s/%s/mask_cihp/%.*s.png", d->root, d->name[person], stem, image);
    int m = snprintf(other, PATH_LENGTH, "%s/%s/mask/%.*s.png", d->root, d->name[person], stem, image);
    if (n < 0 || n >= PATH_LENGTH || m < 0 || m >= PATH_LENGTH)
        return failure(c, SHERF_BAD_FILE, "%.200s/%.200s: path too long", d->root, image);
    if (!path_is_file(out) && path_is_file(other)) memcpy(out, other, sizeof other);
    return SHERF_OK;
}

sherf_status dataset_picture_paths(context *c, const sherf_dataset *d, int person, int pose, int view,
                                   char image[PATH_LENGTH], char mask[PATH_LENGTH]) {
    const person_record *r;
    char name[64];
    sherf_status status = record_at(c, d, person, pose, view, &r);
    if (status) return status;
    if (r->image) {
        const char *relative = r->image[(int64_t)pose * r->views + view];
        if (!relative)
            return failure(c, SHERF_BAD_FILE, "%s: annots.npy lists no view %d of pose %d", d->name[person],
                           view, pose);
        status = dataset_path(c, d, person, relative, image);
        return status ? status : annots_mask(c, d, person, relative, mask);
    }
    bool humman = d->kind == DATA_HUMMAN;
    snprintf(name, sizeof name, humman ? "kinect_color/kinect_%03d/%06d.png" : "img/camera%04d/%04d.jpg",
             view, pose);
    if ((status = dataset_path(c, d, person, name, image))) return status;
    snprintf(name, sizeof name, humman ? "kinect_mask/kinect_%03d/%06d.png" : "mask/camera%04d/%04d.png",
             view, pose);
    return dataset_path(c, d, person, name, mask);
}

sherf_status dataset_pose_paths(context *c, const sherf_dataset *d, int person, int pose,
                                char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]) {
    const person_record *r;
    char name[64];
    vertices[0] = 0;
    sherf_status status = record_at(c, d, person, pose, 0, &r);
    if (status) return status;
    if (d->kind == DATA_RENDERPEOPLE)
        return dataset_path(c, d, person, "outputs_re_fitting/refit_smpl_2nd.npz", parameters);
    if (d->kind == DATA_HUMMAN) {
        snprintf(name, sizeof name, "smpl_params/%06d.npz", pose);
        return dataset_path(c, d, person, name, parameters);
    }
    snprintf(name, sizeof name, "new_vertices/%d.npy", r->number[pose]);
    if ((status = dataset_path(c, d, person, name, vertices))) return status;
    snprintf(name, sizeof name, d->kind == DATA_ZJU ? "new_params/%d.npy" : "new_params_neutral/%d.npy",
             r->number[pose]);
    return dataset_path(c, d, person, name, parameters);
}

/* A layout's pose files hold all of these: what is missing would be taken for zero and the person posed
 * wrongly. */
static sherf_status pose_file_whole(context *c, data_kind kind, const value *v) {
    static const char *const annots[][2] = {
        {"poses", "pose"}, {"shapes", "betas"}, {"R", "Rh"}, {"Th", "Th"}};
    static const char *const humman[][2] = {{"body_pose", "body_pose"},
                                            {"betas", "betas"},
                                            {"global_orient", "global_orient"},
                                            {"transl", "transl"}};
    const char *const(*key)[2] = kind == DATA_HUMMAN ? humman : annots;
    for (int i = 0; i < 4; i++)
        if (!value_get(v, key[i][0]) && !value_get(v, key[i][1]))
            return failure(c, SHERF_BAD_FILE, "no %s: a pose has %s", key[i][kind == DATA_ZJU && i == 2],
                           kind == DATA_HUMMAN ? "betas, global_orient, body_pose and transl"
                                               : "poses, shapes, R (or Rh) and Th");
    return SHERF_OK;
}

sherf_status dataset_pose(context *c, const sherf_dataset *d, int person, int pose, sherf_pose *out) {
    const person_record *r;
    char parameters[PATH_LENGTH], vertices[PATH_LENGTH];
    document *doc = NULL;
    sherf_status status = record_at(c, d, person, pose, 0, &r);
    if (status) return status;
    if (r->pose) {
        *out = r->pose[pose];
        return SHERF_OK;
    }
    if ((status = dataset_pose_paths(c, d, person, pose, parameters, vertices)) ||
        (status = parse_file(c, parameters, &doc, NULL)))
        return status;
    status = pose_file_whole(c, d->kind, doc->root);
    if (!status) status = parse_pose(c, doc->root, out);
    if (status) failure_prefix(c, status, "%s", parameters);
    document_free(doc);
    return status;
}

sherf_status dataset_camera(context *c, const sherf_dataset *d, int person, int view, sherf_camera *out) {
    const person_record *r;
    char image[PATH_LENGTH], mask[PATH_LENGTH];
    int width, height, channels, pose = 0;
    sherf_status status = dataset_record(c, d, person, &r);
    if (status) return status;
    while (r->present && pose + 1 < r->poses && !r->present[pose]) pose++;
    if ((status = dataset_picture_paths(c, d, person, pose, view, image, mask)) ||
        (status = image_size(c, image, &width, &height, &channels)))
        return status;
    double scale = protocols[d->kind].image_scale;
    parsed_camera_to(&r->camera[view], width, height, (int)(width * scale + 1e-6),
                     (int)(height * scale + 1e-6), out);
    return SHERF_OK;
}

static sherf_status read_view(context *c, const sherf_dataset *d, int person, int pose, int view, int width,
                              bool whole, data_view **out) {
    *out = NULL;
    const person_record *r;
    char image[PATH_LENGTH], mask[PATH_LENGTH];
    sherf_status status = record_at(c, d, person, pose, view, &r);
    if (!status) status = dataset_picture_paths(c, d, person, pose, view, image, mask);
    if (status) return status;
    view_source source = {.image = image,
                          .mask = mask,
                          .camera = r->camera[view],
                          .scale = protocols[d->kind].image_scale,
                          .width = width,
                          .whole = whole,
                          .edge_band = d->kind == DATA_ZJU};
    status = dataset_pose(c, d, person, pose, &source.pose);
    return status ? status : view_assemble(c, &source, out);
}

sherf_status dataset_view(context *c, const sherf_dataset *d, int person, int pose, int view, int width,
                          data_view **out) {
    return read_view(c, d, person, pose, view, width, false, out);
}

sherf_status dataset_photo(context *c, const sherf_dataset *d, int person, int pose, int view, int width,
                           sherf_image *out) {
    data_view *v;
    *out = (sherf_image){0};
    sherf_status status = read_view(c, d, person, pose, view, width, true, &v);
    if (status) return status;
    *out = v->image;
    v->image = (sherf_image){0};
    sherf_observation_free(v);
    return SHERF_OK;
}

sherf_status dataset_view_check_mask(context *c, const sherf_dataset *d, int person, int pose, int view,
                                     const data_view *v) {
    char image[PATH_LENGTH], mask[PATH_LENGTH];
    context quiet = {.threads = 1}; /* the message is the check's */
    sherf_status status = observation_check_mask(c, v);
    if (!status || dataset_picture_paths(&quiet, d, person, pose, view, image, mask)) return status;
    return failure_prefix(c, status, "%s", mask);
}

sherf_status dataset_mask_check(context *c, const sherf_dataset *d, int person, int pose, int view) {
    char image[PATH_LENGTH], path[PATH_LENGTH];
    image_u8 mask = {0};
    size_t n, inside = 0;
    sherf_status status = dataset_picture_paths(c, d, person, pose, view, image, path);
    if (!status) status = image_read(c, path, IMAGE_MASK, &mask);
    if (status) return status;
    n = (size_t)mask.width * mask.height;
    for (size_t i = 0; i < n; i++) inside += mask.data[i] != 0;
    mem_free(mask.data);
    if (!(status = mask_shares_check(c, inside, 0, n))) return SHERF_OK;
    return failure_prefix(c, status, "%s", path);
}

sherf_status dataset_person_view(context *c, const sherf_dataset *d, int person, int pose, int view,
                                 int width, data_view **out) {
    sherf_status status = dataset_view(c, d, person, pose, view, width, out);
    if (status || !(status = dataset_view_check_mask(c, d, person, pose, view, *out))) return status;
    sherf_observation_free(*out);
    *out = NULL;
    return status;
}

sherf_status sherf_dataset_observation(sherf_context *c, const sherf_dataset *d, int person, int pose,
                                       int view, sherf_observation **out) {
    return dataset_observation(c, d, person, pose, view, 0, out);
}

sherf_status dataset_observation(context *c, const sherf_dataset *d, int person, int pose, int view,
                                 int width, sherf_observation **out) {
    sherf_status status = dataset_person_view(c, d, person, pose, view, width, out);
    if (status || !(status = observation_check(c, *out))) return status;
    sherf_observation_free(*out);
    *out = NULL;
    return failure_prefix(c, status, "%s, pose %d, view %d", d->name[person], pose, view);
}
