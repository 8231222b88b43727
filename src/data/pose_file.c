/* Files of poses and of cameras. */
#include <string.h>

#include "data/parse.h"

enum { POSES_MAX = 1 << 20 };

static int64_t frames_of(const value *v, const int *unit, size_t units) {
    int64_t numbers = value_numbers(v), rows = parse_rows(v);
    for (size_t i = 0; i < units; i++)
        if (rows >= 1 && rows <= POSES_MAX && numbers == rows * unit[i]) return rows;
    return 1;
}

static int64_t frame_count(const value *v) {
    static const int whole[] = {72, 216}, body[] = {69, 63, 207, 189};
    const value *poses = value_get(v, "poses");
    if (!poses) poses = value_get(v, "pose");
    if (poses) return frames_of(poses, whole, COUNT_OF(whole));
    return frames_of(value_get(v, "body_pose"), body, COUNT_OF(body));
}

/* Frame f of a dict whose entries have one row a frame, or one value for all. Rows are looked at in place. */
static sherf_status pose_frame(context *c, const value *v, int64_t frames, int64_t f, sherf_pose *out) {
    static char keys[][16] = {"poses",         "pose", "shapes", "betas", "R",        "Rh",
                              "global_orient", "Th",   "transl", "trans", "body_pose"};
    value name[COUNT_OF(keys)], row[COUNT_OF(keys)];
    value_pair pair[COUNT_OF(keys)];
    size_t n = 0;
    for (size_t k = 0; k < COUNT_OF(keys); k++) {
        const value *item = value_get(v, keys[k]);
        if (!item) continue;
        row[n] = *item;
        if (frames > 1 && parse_rows(item) == frames) {
            if (item->kind == VALUE_LIST && item->list.item[f]->kind != VALUE_REAL &&
                item->list.item[f]->kind != VALUE_INTEGER)
                row[n] = *item->list.item[f];
            if (item->kind == VALUE_ARRAY && item->array.rank >= 2) {
                size_t bytes = dtype_size(item->array.type);
                row[n].array.rank--;
                for (int a = 0; a < row[n].array.rank; a++) {
                    row[n].array.dim[a] = item->array.dim[a + 1];
                    bytes *= (size_t)row[n].array.dim[a];
                }
                row[n].array.data = (char *)item->array.data + (size_t)f * bytes;
            }
        }
        name[n] = (value){.kind = VALUE_STRING};
        name[n].string.text = keys[k];
        name[n].string.length = strlen(keys[k]);
        pair[n] = (value_pair){&name[n], &row[n]};
        n++;
    }
    value dict = {.kind = VALUE_DICT};
    dict.dict.pair = pair;
    dict.dict.count = n;
    return parse_pose(c, &dict, out);
}

static sherf_status poses_from(context *c, const value *v, sherf_pose **out, int *count) {
    sherf_status status = SHERF_OK;
    const value *inner = value_get(v, "body");
    if (!inner) inner = value_get(v, "smpl");
    if (!inner) inner = value_get(v, "frames");
    v = parse_unwrapped(inner ? inner : v);
    bool list = v && v->kind == VALUE_LIST;
    int64_t frames = list ? (int64_t)v->list.count : v ? frame_count(v) : 0;
    if (frames < 1 || frames > POSES_MAX)
        return failure(c, SHERF_BAD_FILE, "%s poses", frames < 1 ? "no" : "too many");
    sherf_pose *pose = mem_alloc(c, (size_t)frames, sizeof *pose);
    if (!pose) return SHERF_NO_MEMORY;
    for (int64_t f = 0; f < frames && !status; f++) {
        status = list ? parse_pose(c, parse_unwrapped(v->list.item[f]), &pose[f])
                      : pose_frame(c, v, frames, f, &pose[f]);
        if (status && frames > 1) failure_prefix(c, status, "pose %lld", (long long)f);
    }
    if (status) {
        mem_free(pose);
        return status;
    }
    *out = pose;
    *count = (int)frames;
    return SHERF_OK;
}

sherf_status sherf_poses_load(sherf_context *c, const char *path, sherf_pose **out, int *count) {
    *out = NULL;
    *count = 0;
    document *d = NULL;
    sherf_status status = parse_file(c, path, &d, NULL);
    if (status) return status;
    status = poses_from(c, parse_unwrapped(d->root), out, count);
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}

static sherf_status camera_of(context *c, const value *v, sherf_camera *out) {
    parsed_camera camera;
    int64_t width = 0, height = 0;
    sherf_status status = parse_camera(c, v, &camera);
    if (!status && value_get(v, "width"))
        status = value_integer(c, value_get(v, "width"), "camera: width", &width);
    if (!status && value_get(v, "height"))
        status = value_integer(c, value_get(v, "height"), "camera: height", &height);
    if (status) return status;
    if (width < 0 || height < 0 || width > IMAGE_SIDE_MAX || height > IMAGE_SIDE_MAX)
        return failure(c, SHERF_BAD_FILE, "camera: %lld x %lld pixels", (long long)width, (long long)height);
    parsed_camera_to(&camera, 1, 1, 1, 1, out);
    out->width_px = (int)width;
    out->height_px = (int)height;
    return SHERF_OK;
}

static bool is_camera_key(const value *key, bool kinect) {
    static const char color[] = "kinect_color_";
    if (key->kind != VALUE_STRING) return false;
    return !kinect || !strncmp(key->string.text, color, sizeof color - 1);
}

/* The camera dicts of a file in order: "cameras": [...], or name -> camera. */
static size_t camera_values(const value *root, const value **out) {
    const value *list = value_get(root, "cameras");
    if (list && list->kind == VALUE_LIST) {
        for (size_t i = 0; out && i < list->list.count; i++) out[i] = list->list.item[i];
        return list->list.count;
    }
    if (value_get(root, "camera")) root = value_get(root, "camera");
    if (value_get(root, "K")) {
        if (out) out[0] = root;
        return 1;
    }
    if (list) root = list;
    if (root->kind != VALUE_DICT) return 0;
    bool kinect = false;
    size_t n = 0;
    for (size_t i = 0; i < root->dict.count; i++) kinect |= is_camera_key(root->dict.pair[i].key, true);
    for (size_t i = 0; i < root->dict.count; i++)
        if (is_camera_key(root->dict.pair[i].key, kinect) && value_get(root->dict.pair[i].item, "K")) {
            if (out) out[n] = root->dict.pair[i].item;
            n++;
        }
    return n;
}

sherf_status sherf_cameras_load(sherf_context *c, const char *path, sherf_camera **out, int *count) {
    enum { CAMERAS_MAX = 1 << 20 };
    *out = NULL;
    *count = 0;
    document *d = NULL;
    sherf_camera *camera = NULL;
    const value **found = NULL;
    sherf_status status = parse_file(c, path, &d, NULL);
    if (status) return status;
    size_t n = camera_values(d->root, NULL);
    if (n < 1 || n > CAMERAS_MAX) {
        status = failure(c, SHERF_BAD_FILE, "%s: %s cameras", path, n ? "too many" : "no");
        goto done;
    }
    status = SHERF_NO_MEMORY;
    camera = mem_alloc(c, n, sizeof *camera);
    found = mem_alloc(c, n, sizeof *found);
    if (!camera || !found) goto done;
    camera_values(d->root, found);
    status = SHERF_OK;
    for (size_t i = 0; i < n && !status; i++) {
        status = camera_of(c, found[i], &camera[i]);
        if (status) failure_prefix(c, status, "%s: camera %zu", path, i);
    }
    if (status) goto done;
    *out = camera;
    *count = (int)n;
    camera = NULL;
done:
    mem_free(camera);
    mem_free((void *)found);
    document_free(d);
    return status;
}
