/* An observation from a folder or a JSON file (docs/observation.md), or from a data set. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "data/view.h"

/* `name` itself if it is absolute, otherwise relative to the file that names it. */
static sherf_status beside(context *c, const char *folder, const char *name, char out[PATH_LENGTH]) {
    return path_join(c, out, PATH_LENGTH, name[0] == '/' ? "" : folder, name);
}

static sherf_status named_file(context *c, const value *root, const char *key, const char *folder,
                               char out[PATH_LENGTH]) {
    const value *v = value_get(root, key);
    if (!v || v->kind != VALUE_STRING || !v->string.length)
        return failure(c, SHERF_BAD_FILE, "\"%s\" should name a file", key);
    return beside(c, folder, v->string.text, out);
}

static sherf_status optional_index(context *c, const value *root, const char *key, int count, int *out) {
    int64_t i = 0;
    const value *v = value_get(root, key);
    sherf_status status = v ? value_integer(c, v, key, &i) : SHERF_OK;
    if (status) return status;
    if (i < 0 || i >= count)
        return failure(c, SHERF_BAD_FILE, "\"%s\": %lld, there are %d", key, (long long)i, count);
    *out = (int)i;
    return SHERF_OK;
}

/* The camera's size, if given, must be the picture's. */
static sherf_status camera_size_check(context *c, int width, int height, const int size[2]) {
    if ((!width || width == size[0]) && (!height || height == size[1])) return SHERF_OK;
    return failure(c, SHERF_MISMATCH, "camera: for %d x %d pixels, the picture has %d x %d", width, height,
                   size[0], size[1]);
}

/* R and T may be missing: the body is then given in the camera's own frame. */
static sherf_status camera_object(context *c, const char *what, const value *v, const int size[2],
                                  parsed_camera *out) {
    char name[PATH_LENGTH + 16];
    v = value_unwrapped(v);
    if (camera_stack(v) > 1)
        return failure(c, SHERF_BAD_FILE,
                       "camera: %lld of them, one after the other in each array: name a file with them, and "
                       "choose by \"camera_index\"",
                       (long long)camera_stack(v));
    sherf_status status = parse_camera(c, v, NULL, size, out);
    if (!status) status = camera_size_check(c, out->width, out->height, size);
    snprintf(name, sizeof name, "%s: camera", what);
    if (!status) camera_warn(c, v, out, name);
    return status;
}

/* If there are several and no index, the first is taken, with a warning. */
static void several_warn(context *c, const char *path, const value *root, const char *key, int count) {
    if (count < 2 || value_get(root, key)) return;
    log_line(c, SHERF_LOG_WARNING, "%s: the first of %d is taken; \"%s\" takes another", path, count, key);
}

/* Of a path's last part, without its extension: where it begins, and its length. */
static size_t stem_of(const char **path) {
    const char *slash = strrchr(*path, '/');
    if (slash) *path = slash + 1;
    const char *point = strrchr(*path, '.');
    return point && point != *path ? (size_t)(point - *path) : strlen(*path);
}

/* The only camera with the name, as it is or as the stem of a file's name; -1: none, or several. */
static int camera_named(const parsed_camera *camera, int count, const char *name, bool stem) {
    int found = -1;
    size_t length = strlen(name);
    if (stem) length = stem_of(&name);
    for (int i = 0; i < count; i++) {
        const char *own = camera[i].name;
        const size_t own_length = stem ? stem_of(&own) : strlen(own);
        if (!own_length || own_length != length || memcmp(own, name, length)) continue;
        if (found >= 0) return -1;
        found = i;
    }
    return found;
}

static sherf_status camera_by_name(context *c, const char *path, const value *name, const value *index,
                                   const parsed_camera *camera, int count, int *out) {
    if (name->kind != VALUE_STRING || index)
        return failure(c, SHERF_BAD_FILE, "\"camera_name\" should be a text, without \"camera_index\"");
    *out = camera_named(camera, count, name->string.text, false);
    if (*out >= 0) return SHERF_OK;
    return failure(c, SHERF_BAD_FILE,
                   "%s: \"%.60s\" is the name of no single one of the %d cameras; the first is \"%s\"", path,
                   name->string.text, count, camera->name);
}

/* By "camera_index" or "camera_name"; otherwise by the picture's name, or the first. */
static sherf_status camera_choose(context *c, const char *path, const char *image, const value *root,
                                  const parsed_camera *camera, int count, int *out) {
    const value *name = value_get(root, "camera_name"), *index = value_get(root, "camera_index");
    *out = 0;
    if (name) return camera_by_name(c, path, name, index, camera, count, out);
    if (index || count < 2) return optional_index(c, root, "camera_index", count, out);
    const int same = camera_named(camera, count, image, true);
    if (same < 0) several_warn(c, path, root, "camera_index", count);
    if (same < 0) return SHERF_OK;
    *out = same;
    log_line(c, SHERF_LOG_INFO, "%s: the camera %s of %d, by the picture's name", path, camera[same].name,
             count);
    return SHERF_OK;
}

static sherf_status camera_from_file(context *c, const char *path, const char *image, const value *root,
                                     const int size[2], parsed_camera *out) {
    parsed_camera *camera = NULL;
    int count, i = 0;
    sherf_status status = cameras_read(c, path, size, &camera, &count);
    if (!status) status = camera_choose(c, path, image, root, camera, count, &i);
    if (!status) status = camera_size_check(c, camera[i].width, camera[i].height, size);
    if (!status) *out = camera[i];
    mem_free(camera);
    return status;
}

/* By "body_index"; otherwise the one that is called like the picture, or the first. */
static sherf_status pose_from_file(context *c, const char *path, const char *image, const value *root,
                                   sherf_pose *out) {
    sherf_pose *pose = NULL;
    char name[PATH_LENGTH];
    int count, same, i = 0;
    const size_t length = stem_of(&image);
    snprintf(name, sizeof name, "%.*s", (int)length, image);
    sherf_status status = poses_named_read(c, path, name, &pose, &count, &same);
    const bool chosen = value_get(root, "body_index") != NULL;
    if (!status) status = optional_index(c, root, "body_index", count, &i);
    if (!status && !chosen && same >= 0) i = same;
    if (!status && (chosen || same < 0)) several_warn(c, path, root, "body_index", count);
    if (!status) *out = pose[i];
    mem_free(pose);
    return status;
}

typedef struct {
    char image[PATH_LENGTH], mask[PATH_LENGTH], other[PATH_LENGTH];
} file_names;

/* A value of the mask, a colour, or "all". */
static sherf_status mask_label_of(context *c, const value *v, mask_label *out) {
    double color[3];
    *out = (mask_label){MASK_LABEL_ANY, 0};
    if (value_is_string(v, "all")) out->kind = MASK_LABEL_ALL;
    if (!v || out->kind) return SHERF_OK;
    const bool three = value_numbers(v) == 3;
    sherf_status status = value_doubles(c, v, "mask_label", three ? 3 : 1, color);
    for (int k = 0; k < 3 && !status; k++) {
        const double one = color[three ? k : 0];
        if (!(one >= 0 && one <= 255 && one == floor(one)))
            return failure(
                c, SHERF_BAD_FILE,
                "\"mask_label\" should be a value of the mask (1 to 255), a colour ([r, g, b]) or \"all\"");
        out->color = out->color << 8 | (uint32_t)one;
    }
    out->kind = MASK_LABEL_ONE;
    return status;
}

static sherf_status observation_from_json(context *c, const char *path, const value *root, const char *folder,
                                          file_names *names, view_source *source) {
    static const char *const known[] = {"image",        "mask",        "mask_label", "camera",  "body",
                                        "camera_index", "camera_name", "body_index", "comment", NULL};
    sherf_status status;
    int size[2], channels;
    const value *camera = value_get(root, "camera"), *body = value_get(root, "body");
    if ((status = named_file(c, root, "image", folder, names->image)) ||
        (value_get(root, "mask") && (status = named_file(c, root, "mask", folder, names->mask))) ||
        (status = mask_label_of(c, value_get(root, "mask_label"), &source->label)) ||
        (status = image_size(c, names->image, &size[0], &size[1], &channels)))
        return status;
    if (camera && camera->kind == VALUE_STRING) {
        if ((status = named_file(c, root, "camera", folder, names->other)) ||
            (status = camera_from_file(c, names->other, names->image, root, size, &source->camera)))
            return status;
    } else if (!camera) {
        return failure(c, SHERF_BAD_FILE, "\"camera\" is missing");
    } else if ((status = camera_object(c, path, camera, size, &source->camera))) {
        return status;
    }
    unknown_keys_warn(c, root, known, path);
    if (body && body->kind == VALUE_STRING) {
        if ((status = named_file(c, root, "body", folder, names->other))) return status;
        return pose_from_file(c, names->other, names->image, root, &source->pose);
    }
    if (!body) return failure(c, SHERF_BAD_FILE, "\"body\" is missing");
    status = parse_pose(c, body, &source->pose);
    if (status) return failure_prefix(c, status, "body");
    snprintf(names->other, sizeof names->other, "%.4000s: body", path);
    body_parts_warn(c, body, names->other);
    return SHERF_OK;
}

/* The first of these names that is a file in the folder. */
static sherf_status first_file(context *c, const char *folder, const char *const *name,
                               char out[PATH_LENGTH]) {
    for (size_t i = 0; name[i]; i++) {
        sherf_status status = path_join(c, out, PATH_LENGTH, folder, name[i]);
        if (status) return status;
        if (path_is_file(out)) return SHERF_OK;
    }
    return failure(c, SHERF_NO_FILE,
                   "%s: neither observation.json nor %s in it; a folder of photos is for sherf estimate, a "
                   "person of a data set is named DATA#PERSON/POSE/VIEW",
                   folder, name[0]);
}

/* A folder without observation.json: files with fixed names. */
static sherf_status observation_from_folder(context *c, const char *folder, file_names *names,
                                            view_source *source) {
    static const char *const images[] = {"image.png",  "image.jpg",  "image.jpeg", "image.webp",
                                         "image.heic", "image.heif", "image.avif", NULL};
    static const char *const cameras[] = {"camera.json", NULL};
    static const char *const bodies[] = {"body.json", "body.npz", "body.npy", NULL};
    int size[2], channels;
    document *d = NULL;
    sherf_status status;
    if ((status = first_file(c, folder, images, names->image)) ||
        (status = path_join(c, names->mask, sizeof names->mask, folder, "mask.png")) ||
        (status = image_size(c, names->image, &size[0], &size[1], &channels)) ||
        (status = first_file(c, folder, cameras, names->other)) || (status = json_read(c, names->other, &d)))
        return status;
    if (!path_is_file(names->mask)) names->mask[0] = 0; /* then the picture's alpha */
    const value *camera = value_get(d->root, "camera");
    status = camera_object(c, names->other, camera ? camera : d->root, size, &source->camera);
    if (status) failure_prefix(c, status, "%s", names->other);
    document_free(d);
    if (status || (status = first_file(c, folder, bodies, names->other))) return status;
    value none = {.kind = VALUE_NONE};
    return pose_from_file(c, names->other, names->image, &none, &source->pose);
}

/* A body without a translation and a camera without one are in the same place. */
static sherf_status placed_check(context *c, const char *path, const view_source *source) {
    for (int i = 0; i < 3; i++)
        if (source->camera.T[i] != 0 || source->pose.Th_m[i] != 0) return SHERF_OK;
    return failure(
        c, SHERF_BAD_FILE,
        "%s: the body has no translation (transl, Th, cam_t, ...) and the camera no T: one of them "
        "is needed; pred_cam (s, tx, ty) is none",
        path);
}

static sherf_status observation_from_files(context *c, const char *path, sherf_observation **out) {
    sherf_status status;
    document *d = NULL;
    bool folder = path_is_folder(path);
    char json[PATH_LENGTH], base[PATH_LENGTH];
    view_source source = {.scale = 1, .observed = true};
    file_names *names = mem_zero(c, 1, sizeof *names);
    if (!names) return SHERF_NO_MEMORY;
    if ((status = path_join(c, base, sizeof base, "", path))) goto done;
    if (folder) {
        if ((status = path_join(c, json, sizeof json, path, "observation.json"))) goto done;
    } else {
        memcpy(json, base, sizeof json);
        char *slash = strrchr(base, '/');
        if (!slash)
            strcpy(base, ".");
        else if (slash == base)
            base[1] = 0;
        else
            *slash = 0;
    }
    if (folder && !path_is_file(json)) {
        status = observation_from_folder(c, path, names, &source);
    } else {
        if ((status = json_read(c, json, &d))) goto done;
        status = observation_from_json(c, json, d->root, base, names, &source);
        if (status) failure_prefix(c, status, "%s", json);
    }
    if (!status) status = placed_check(c, path, &source);
    source.image = names->image;
    source.mask = names->mask[0] ? names->mask : NULL;
    if (status || (status = view_assemble(c, &source, out))) goto done;
    status = observation_check(c, *out);
    if (status) failure_prefix(c, status, "%s", path);
done:
    mem_free(names);
    document_free(d);
    if (status) {
        sherf_observation_free(*out);
        *out = NULL;
    }
    return status;
}

/* DATA#PERSON/POSE/VIEW: the person by name or list line. */
static sherf_status observation_from_dataset(context *c, const char *path, const char *hash,
                                             sherf_observation **out) {
    char spec[PATH_LENGTH], person[PATH_LENGTH];
    sherf_dataset *d = NULL;
    int *index = NULL, count = 0, pose, view, end = 0;
    size_t n = (size_t)(hash - path);
    if (n >= sizeof spec || strlen(hash) >= sizeof person)
        return failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", path);
    memcpy(spec, path, n);
    spec[n] = 0;
    strcpy(person, hash + 1);
    char *slash = strrchr(person, '/');
    if (slash) *slash = 0;
    char *first = slash ? strrchr(person, '/') : NULL;
    if (first) *first = 0;
    if (!first || !person[0] || sscanf(hash + 1 + (first - person), "/%d/%d%n", &pose, &view, &end) != 2 ||
        hash[1 + (first - person) + end])
        return failure(c, SHERF_BAD_ARGUMENT, "%s: expected DATA#PERSON/POSE/VIEW", path);
    sherf_status status = sherf_dataset_open(c, spec, &d);
    if (!status) status = dataset_people(c, d, person, false, &index, &count);
    if (!status && count != 1)
        status = failure(c, SHERF_BAD_ARGUMENT, "%s: names %d people, expected one", path, count);
    if (!status) status = sherf_dataset_observation(c, d, index[0], pose, view, out);
    mem_free(index);
    sherf_dataset_free(d);
    return status;
}

sherf_status sherf_observation_load(sherf_context *c, const char *path, sherf_observation **out) {
    *out = NULL;
    if (path_is_file(path) && image_file_kind(path))
        return failure(c, SHERF_BAD_FILE,
                       "%s: a picture alone is no observation: camera, body pose and mask belong to it, "
                       "named in an observation.json (docs/observation.md)",
                       path);
    if (path_is_folder(path) || path_is_file(path)) return observation_from_files(c, path, out);
    const char *hash = strrchr(path, '#');
    if (hash) return observation_from_dataset(c, path, hash, out);
    return failure(c, SHERF_NO_FILE, "%s: no such file or folder", path);
}
