/* Reads files of poses and of cameras. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "data/camera_files.h"

enum { POSES_MAX = 1 << 20 };

/* An observation's JSON provides its body. */
static const value *body_root(const value *root) {
    root = value_unwrapped(root);
    const value *body = value_unwrapped(value_get(root, "body"));
    return body && body->kind == VALUE_LIST ? body : root;
}

static int64_t frames_of(const value *v, const int *unit, size_t units) {
    int64_t numbers = value_numbers(v), rows = parse_rows(v);
    for (size_t i = 0; i < units; i++)
        if (rows >= 1 && rows <= POSES_MAX && numbers == rows * unit[i]) return rows;
    return 1;
}

static const int six_counts[] = {24, 22, 52, 55, 53, 23, 21, 0};

/* Rows of six numbers a joint; 0: they are not. */
static int64_t six_frames(const value *v) {
    const int64_t rows = parse_rows(v);
    if (rows < 1 || rows > POSES_MAX) return 0;
    const value row = parse_row_of(v, 0);
    return value_numbers(v) == rows * value_numbers(&row) && six_joints(&row, six_counts) ? rows : 0;
}

static int64_t frame_count(const body_parts *parts) {
    static const int whole[] = {72, 216, 66, 156, 165, 159, 198, 468, 495}, body[] = {69, 63, 207, 189};
    const value *poses = parts->part[PART_POSES].item;
    const int64_t six = six_frames(poses ? poses : parts->part[PART_BODY].item);
    if (six) return six;
    if (poses) return frames_of(poses, whole, COUNT_OF(whole));
    return frames_of(parts->part[PART_BODY].item, body, COUNT_OF(body));
}

/* Whether an entry has one row for each frame rather than one value for all. */
static bool by_frame(const value *item, int64_t frames) {
    if (!item || frames < 2 || parse_rows(item) != frames) return false;
    if (item->kind == VALUE_ARRAY) return item->array.rank >= 2;
    return item->list.item[0]->kind != VALUE_REAL && item->list.item[0]->kind != VALUE_INTEGER;
}

static sherf_status pose_frame(context *c, const body_parts *all, int64_t frames, int64_t f,
                               sherf_pose *out) {
    body_parts own = *all;
    value row[PARTS];
    for (int p = 0; p < PARTS; p++) {
        if (!by_frame(all->part[p].item, frames)) continue;
        row[p] = parse_row_of(all->part[p].item, (size_t)f);
        own.part[p].item = &row[p];
    }
    return parse_parts(c, &own, out);
}

static bool has_rotations(const body_parts *parts) {
    return parts->part[PART_POSES].item || parts->part[PART_BODY].item;
}

/* A list of bodies, alone or under "frames"; NULL: one dict for all. */
static const value *list_of(const value *root) {
    const value *frames = value_get(root, "frames");
    const value *v = value_unwrapped(frames ? frames : root);
    return v && v->kind == VALUE_LIST ? v : NULL;
}

enum { SIX_NUMBERS_MAX = 55 * SIX };

/* The part with the body's rotations; first: SMPL's joint that it begins with. */
static const named_value *rotations_of(const body_parts *parts, int *first) {
    const bool whole = parts->part[PART_POSES].item != NULL;
    *first = !whole;
    return &parts->part[whole ? PART_POSES : PART_BODY];
}

/* Rotations of six numbers: all frames together show what they are. */
static sherf_status six_of_frames(context *c, body_parts *parts) {
    int first;
    const named_value *rows = rotations_of(parts, &first);
    const int64_t frames = six_frames(rows->item);
    double numbers[SIX_NUMBERS_MAX];
    six_evidence shown = {0};
    six_form form;
    if (frames < 2 || parts->six) return SHERF_OK;
    const size_t n = (size_t)(value_numbers(rows->item) / frames);
    for (int64_t f = 0; f < frames; f++) {
        sherf_status status = parse_row(c, rows->item, (size_t)f, rows->name, n, numbers);
        if (status) return status;
        six_add(&shown, numbers, (int)(n / SIX), first);
    }
    sherf_status status = six_decide(c, rows->name, &shown, SIX_UNKNOWN, &form);
    if (status) return status;
    six_log(c, rows->name, &form);
    parts->six = form.kind;
    return SHERF_OK;
}

/* The same of bodies apart. Unknown: fewer than two of them have six numbers a joint and no word on them. */
static sherf_status six_of_list(context *c, const named_value *found, size_t count, six_kind *out) {
    double numbers[SIX_NUMBERS_MAX];
    six_evidence shown = {0};
    const char *name = NULL;
    six_form form;
    for (size_t f = 0; f < count; f++) {
        body_parts parts;
        int first;
        body_parts_find(value_unwrapped(found[f].item), &parts);
        const named_value *rows = rotations_of(&parts, &first);
        const int joints = rows->item && !parts.six ? six_joints(rows->item, six_counts) : 0;
        if (!joints || value_doubles(c, rows->item, rows->name, (size_t)joints * SIX, numbers)) continue;
        six_add(&shown, numbers, joints, first);
        name = rows->name;
    }
    *out = SIX_UNKNOWN;
    if (shown.frames < 2) return SHERF_OK;
    sherf_status status = six_decide(c, name, &shown, SIX_UNKNOWN, &form);
    if (status) return status;
    six_log(c, name, &form);
    *out = form.kind;
    return SHERF_OK;
}

static sherf_status pose_of(context *c, const value *v, six_kind six, sherf_pose *out) {
    body_parts parts;
    body_parts_find(v, &parts);
    if (!has_rotations(&parts)) return parse_pose(c, v, out); /* says so */
    if (!parts.six) parts.six = six;
    return parse_parts(c, &parts, out);
}

static sherf_status poses_of_list(context *c, const named_value *found, size_t count, sherf_pose *pose) {
    six_kind six;
    sherf_status status = six_of_list(c, found, count, &six);
    for (size_t f = 0; f < count && !status; f++) {
        status = pose_of(c, value_unwrapped(found[f].item), six, &pose[f]);
        if (status && found[f].name) failure_prefix(c, status, "%.60s", found[f].name);
        if (status && count > 1) failure_prefix(c, status, "pose %zu", f);
    }
    return status;
}

static sherf_status poses_of_dict(context *c, const body_parts *given, int64_t frames, sherf_pose *pose) {
    body_parts parts = *given;
    sherf_status status = six_of_frames(c, &parts);
    for (int64_t f = 0; f < frames && !status; f++) {
        status = pose_frame(c, &parts, frames, f, &pose[f]);
        if (status && frames > 1) failure_prefix(c, status, "pose %lld", (long long)f);
    }
    return status;
}

/* The bodies of a list, or of a dict of dicts by name (HumanNeRF's mesh_infos), of one frame each. out NULL:
 * counts them. */
static size_t bodies_of(const value *root, named_value *out) {
    const value *list = list_of(root);
    body_parts parts;
    size_t n = 0;
    for (size_t i = 0; list && out && i < list->list.count; i++)
        out[i] = (named_value){NULL, list->list.item[i]};
    if (list) return list->list.count;
    for (size_t i = 0; root && root->kind == VALUE_DICT && i < root->dict.count; i++) {
        const value *key = root->dict.pair[i].key, *item = value_unwrapped(root->dict.pair[i].item);
        if (key->kind != VALUE_STRING || !item || item->kind != VALUE_DICT) continue;
        body_parts_find(item, &parts);
        if (!has_rotations(&parts) || frame_count(&parts) != 1) continue;
        if (out) out[n] = (named_value){key->string.text, item};
        n++;
    }
    return n;
}

static sherf_status frames_check(context *c, int64_t frames) {
    if (frames >= 1 && frames <= POSES_MAX) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE, "%s poses", frames < 1 ? "no" : "too many");
}

/* Several bodies. same: the one called `name` (may be NULL); -1: none, or several. */
static sherf_status poses_apart(context *c, const char *path, const value *v, size_t count, const char *name,
                                sherf_pose **out, int *same) {
    sherf_status status = frames_check(c, (int64_t)count);
    if (status) return status;
    named_value *found = mem_alloc(c, count, sizeof *found);
    *out = found ? mem_alloc(c, count, sizeof **out) : NULL;
    status = *out ? SHERF_OK : SHERF_NO_MEMORY;
    if (!status) {
        bodies_of(v, found);
        body_parts_warn(c, found->item, path);
        status = poses_of_list(c, found, count, *out);
    }
    for (size_t i = 0; i < count && !status && name; i++)
        if (found[i].name && !strcmp(found[i].name, name)) *same = *same == -1 ? (int)i : -2;
    mem_free(found);
    return status;
}

/* `path` is for the warning about unread keys. */
static sherf_status poses_from(context *c, const char *path, const value *v, const char *name,
                               sherf_pose **out, int *count, int *same) {
    body_parts parts;
    body_parts_find(v, &parts);
    const size_t apart = list_of(v) || !has_rotations(&parts) ? bodies_of(v, NULL) : 0;
    sherf_status status;
    int64_t frames = (int64_t)apart;
    if (apart || list_of(v)) {
        status = poses_apart(c, path, v, apart, name, out, same);
    } else {
        if (!has_rotations(&parts)) return body_parts_missing(c, v);
        frames = frame_count(&parts);
        if ((status = frames_check(c, frames))) return status;
        body_parts_warn(c, v, path);
        *out = mem_alloc(c, (size_t)frames, sizeof **out);
        status = *out ? poses_of_dict(c, &parts, frames, *out) : SHERF_NO_MEMORY;
    }
    *count = (int)frames;
    return status;
}

sherf_status poses_named_read(context *c, const char *path, const char *name, sherf_pose **out, int *count,
                              int *same) {
    *out = NULL;
    *count = 0;
    *same = -1;
    document *d = NULL;
    sherf_status status = parse_file(c, path, &d, NULL);
    if (status) return status;
    status = poses_from(c, path, body_root(d->root), name, out, count, same);
    document_free(d);
    if (*same < 0) *same = -1;
    if (!status) return SHERF_OK;
    mem_free(*out);
    *out = NULL;
    *count = 0;
    return failure_prefix(c, status, "%s", path);
}

sherf_status sherf_poses_load(sherf_context *c, const char *path, sherf_pose **out, int *count) {
    int same;
    return poses_named_read(c, path, NULL, out, count, &same);
}

static bool is_camera_key(const value *key, bool kinect) {
    static const char color[] = "kinect_color_";
    if (key->kind != VALUE_STRING) return false;
    return !kinect || !strncmp(key->string.text, color, sizeof color - 1);
}

static size_t list_values(const value *list, named_value *out) {
    for (size_t i = 0; out && i < list->list.count; i++) out[i] = (named_value){NULL, list->list.item[i]};
    return list->list.count;
}

/* The camera dicts of a dict with names as keys. */
static size_t named_values(const value *dict, named_value *out) {
    bool kinect = false;
    size_t n = 0;
    if (dict->kind != VALUE_DICT) return 0;
    for (size_t i = 0; i < dict->dict.count; i++) kinect |= is_camera_key(dict->dict.pair[i].key, true);
    for (size_t i = 0; i < dict->dict.count; i++) {
        const value_pair *p = &dict->dict.pair[i];
        if (!is_camera_key(p->key, kinect) || !camera_is(p->item)) continue;
        if (out) out[n] = (named_value){p->key->string.text, p->item};
        n++;
    }
    return n;
}

/* The camera dicts of a file in order: "cameras": [...], or name -> camera. out NULL: counts them. */
static size_t camera_values(const value *root, named_value *out) {
    const value *cameras = value_get(root, "cameras"), *one = value_get(root, "camera"),
                *frames = value_get(root, "frames");
    if (cameras && cameras->kind == VALUE_LIST) return list_values(cameras, out);
    /* NeRF's transforms.json: the lens may be beside the frames */
    if (frames && frames->kind == VALUE_LIST && value_get(value_at(frames, 0), "transform_matrix"))
        return list_values(frames, out);
    if (!one) one = root;
    if (!camera_is(one)) return named_values(cameras ? cameras : one, out);
    if (out) out[0] = (named_value){NULL, one};
    return 1;
}

enum { CAMERAS_MAX = 1 << 20 };

static sherf_status no_cameras(context *c, const value *root, size_t n) {
    if (n) return failure(c, SHERF_BAD_FILE, "too many cameras");
    if (root->kind != VALUE_ARRAY) return failure(c, SHERF_BAD_FILE, "no cameras");
    return failure(c, SHERF_BAD_FILE,
                   "no cameras, an array: write a dict of them, as np.savez(file, K=..., RT=...) does");
}

/* The cameras of `n` dicts, or of one dict with `count` of them. pair, item: room for one dict. */
static sherf_status cameras_parse(context *c, const document *d, const named_value *found, size_t n,
                                  const int size[2], size_t count, parsed_camera *camera) {
    const size_t keys = n == 1 && found->item->kind == VALUE_DICT ? found->item->dict.count : 0;
    value_pair *pair = mem_alloc(c, keys, sizeof *pair);
    value *item = mem_alloc(c, keys, sizeof *item), single;
    const bool stacked = n == 1 && count > 1;
    sherf_status status = pair && item ? SHERF_OK : SHERF_NO_MEMORY;
    for (size_t i = 0; i < count && !status; i++) {
        const value *v = found[n > 1 ? i : 0].item;
        if (stacked) single = camera_unstack(v, (int64_t)count, (int64_t)i, pair, item), v = &single;
        status = parse_camera(c, v, stacked ? NULL : d->root, size, &camera[i]);
        if (!status) status = parsed_camera_placed(c, &camera[i]);
        if (status) failure_prefix(c, status, "camera %zu", i);
        if (n > 1 && found[i].name) parsed_camera_name(&camera[i], found[i].name);
    }
    mem_free(pair);
    mem_free(item);
    return status;
}

/* The folder of view v's picture: "Camera_B1" of Camera_B1/000000.jpg. */
static void annots_name(const value *views, int v, parsed_camera *camera) {
    const value *picture = value_at(views, (size_t)v);
    char folder[sizeof camera->name];
    const char *text = picture && picture->kind == VALUE_STRING ? picture->string.text : "";
    const char *slash = strrchr(text, '/');
    if (!slash || snprintf(folder, sizeof folder, "%.*s", (int)(slash - text), text) != slash - text) return;
    parsed_camera_name(camera, folder);
}

/* annots.npy: cams beside the pictures' names. ZJU-MoCap's T is in millimetres, THuman's in metres; people
 * are within 100 m. */
static void annots_finish(context *c, const char *path, const value *root, parsed_camera *camera, int count) {
    static const double far = 100;
    const value *ims = value_get(root, "ims"), *views = value_get(value_at(ims, 0), "ims");
    double sum = 0;
    if (!value_get(root, "cams") || !ims) return;
    for (int i = 0; i < count; i++) {
        const double *T = camera[i].T;
        sum += sqrt(T[0] * T[0] + T[1] * T[1] + T[2] * T[2]);
        annots_name(views, i, &camera[i]);
    }
    if (!(sum > far * count)) return;
    for (int i = 0; i < 3 * count; i++) camera[i / 3].T[i % 3] /= 1000;
    log_line(c, SHERF_LOG_INFO, "%s: T is %.0f long, read as millimetres, as ZJU-MoCap's", path, sum / count);
}

static sherf_status cameras_of(context *c, const char *path, const document *d, const int size[2],
                               parsed_camera **out, int *count) {
    const size_t n = camera_values(d->root, NULL);
    if (n < 1 || n > CAMERAS_MAX) return no_cameras(c, d->root, n);
    named_value *found = mem_alloc(c, n, sizeof *found);
    if (!found) return SHERF_NO_MEMORY;
    camera_values(d->root, found);
    camera_warn(c, found->item, NULL, path);
    const int64_t all = n == 1 ? camera_stack(found->item) : (int64_t)n;
    parsed_camera *camera = all <= CAMERAS_MAX ? mem_alloc(c, (size_t)all, sizeof *camera) : NULL;
    sherf_status status = all > CAMERAS_MAX ? no_cameras(c, d->root, (size_t)all)
                          : !camera         ? SHERF_NO_MEMORY
                                            : cameras_parse(c, d, found, n, size, (size_t)all, camera);
    mem_free(found);
    if (status) {
        mem_free(camera);
        return status;
    }
    annots_finish(c, path, d->root, camera, (int)all);
    *out = camera;
    *count = (int)all;
    return SHERF_OK;
}

sherf_status cameras_read(context *c, const char *path, const int size[2], parsed_camera **out, int *count) {
    *out = NULL;
    *count = 0;
    document *d = NULL;
    sherf_status status = camera_document_read(c, path, &d);
    if (status) return status;
    status = cameras_of(c, path, d, size, out, count);
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

/* Frames are rendered with a pinhole camera, so the distortion is ignored, with a message. */
static void lens_warn(context *c, const char *path, const parsed_camera *camera) {
    for (int i = 0; i < DISTORTION_MAX; i++)
        if (camera->D[i] != 0) {
            log_line(c, SHERF_LOG_INFO, "%s: D is not used: frames are without the lens's distortion", path);
            return;
        }
}

sherf_status sherf_cameras_load(sherf_context *c, const char *path, sherf_camera **out, int *count) {
    parsed_camera *camera;
    *out = NULL;
    sherf_status status = cameras_read(c, path, NULL, &camera, count);
    if (!status && !(*out = mem_alloc(c, (size_t)*count, sizeof **out))) status = SHERF_NO_MEMORY;
    for (int i = 0; i < *count && !status; i++) {
        parsed_camera_to(&camera[i], 1, 1, 1, 1, &(*out)[i]);
        (*out)[i].width_px = camera[i].width;
        (*out)[i].height_px = camera[i].height;
        if (!i) lens_warn(c, path, camera);
    }
    if (status) *count = 0;
    mem_free(camera);
    return status;
}
