/* Data sets of all layouts with one interface: people, views, poses. Everything is read on request. Records
 * of people are cached under a lock, so that several contexts can share a data set. */
#include <stdio.h>
#include <string.h>

#include "data/dataset.h"

const data_protocol *dataset_protocol(const sherf_dataset *d) {
    return &d->reader->protocol;
}

int protocol_front(const data_protocol *p, int views) {
    return p->front_view < views ? p->front_view : p->front_view * views / p->views;
}

void record_free(person_record *r) {
    if (!r) return;
    for (int64_t i = 0; r->image && i < (int64_t)r->poses * r->views; i++) mem_free(r->image[i]);
    mem_free(r->image);
    mem_free(r->camera);
    mem_free(r->number);
    mem_free(r->pose);
    mem_free(r->present);
    mem_free(r);
}

int sherf_dataset_person_count(const sherf_dataset *d) {
    return d->people;
}

const char *sherf_dataset_person(const sherf_dataset *d, int person) {
    return person >= 0 && person < d->people ? d->name[person] : NULL;
}

int dataset_find(const sherf_dataset *d, const char *name, size_t length) {
    for (int i = 0; i < d->people; i++)
        if (strlen(d->name[i]) == length && !strncmp(d->name[i], name, length)) return i;
    return -1;
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
        if (!status) status = d->reader->record(c, folder, r);
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
    return SHERF_OK;
}

sherf_status dataset_picture_paths(context *c, const sherf_dataset *d, int person, int pose, int view,
                                   char image[PATH_LENGTH], char mask[PATH_LENGTH]) {
    const person_record *r;
    char folder[PATH_LENGTH];
    sherf_status status = record_at(c, d, person, pose, view, &r);
    if (!status) status = dataset_path(c, d, person, "", folder);
    return status ? status : d->reader->picture(c, r, folder, pose, view, image, mask);
}

sherf_status dataset_pose_paths(context *c, const sherf_dataset *d, int person, int pose,
                                char parameters[PATH_LENGTH], char vertices[PATH_LENGTH]) {
    const person_record *r;
    char folder[PATH_LENGTH];
    sherf_status status = record_at(c, d, person, pose, 0, &r);
    if (!status) status = dataset_path(c, d, person, "", folder);
    return status ? status : d->reader->pose_files(c, r, folder, pose, parameters, vertices);
}

/* A missing part of a pose would be taken for zero, and the person posed wrongly. */
static sherf_status pose_file_whole(context *c, const dataset_reader *reader, const value *v) {
    for (int i = 0; i < DATASET_POSE_KEYS; i++) {
        const char *const *key = reader->pose_keys[i];
        if (!value_get(v, key[0]) && !value_get(v, key[1]))
            return failure(c, SHERF_BAD_FILE, "no %s: a pose has %s", key[0], reader->pose_needs);
    }
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
    status = pose_file_whole(c, d->reader, doc->root);
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
    double scale = d->reader->protocol.image_scale;
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
                          .scale = d->reader->protocol.image_scale,
                          .width = width,
                          .whole = whole,
                          .edge_band = d->reader->edge_band};
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
    if (!(status = observation_check_shares(c, inside, 0, n))) return SHERF_OK;
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
