/* Camera files of which several make the cameras: EasyMocap's intri.yml and extri.yml, COLMAP's cameras.txt
 * and images.txt. Either file, or the folder with both, names them. They become {"cameras": [...]}. */
#include "data/camera_files.h"

#include <stdio.h>
#include <string.h>

#include "base/path.h"

static const size_t text_bytes_max = (size_t)512 << 20;

/* ---- EasyMocap ---- */

/* The value under PREFIX_NAME. */
static const value *entry_of(const value *dict, const char *prefix, const char *name) {
    char key[128];
    snprintf(key, sizeof key, "%s_%.100s", prefix, name);
    return value_get(dict, key);
}

static bool take_entry(builder *b, value *camera, const char *key, const value *dict, const char *prefix,
                       const char *name) {
    const value *v = entry_of(dict, prefix, name);
    value *own = v ? build_value(b, v->kind) : NULL;
    if (!v) return true;
    if (own) *own = *v;
    return own && build_entry(b, camera, key, own);
}

/* Rot is a matrix, R the same as an axis-angle. */
static value *easymocap_camera(builder *b, const value *intri, const value *extri, const char *name) {
    value *camera = build_value(b, VALUE_DICT);
    const bool matrix = entry_of(extri, "Rot", name) != NULL;
    if (!camera || !build_entry(b, camera, "name", build_string(b, name, strlen(name))) ||
        !take_entry(b, camera, "K", intri, "K", name) ||
        !take_entry(b, camera, "dist", intri, "dist", name) ||
        !take_entry(b, camera, "width", intri, "W", name) ||
        !take_entry(b, camera, "height", intri, "H", name) ||
        !take_entry(b, camera, "R", extri, matrix ? "Rot" : "R", name) ||
        !take_entry(b, camera, "T", extri, "T", name))
        return NULL;
    return camera;
}

/* The cameras of a file are those that have a K there. */
static value *easymocap_cameras(builder *b, const value *intri, const value *extri) {
    value *list = build_value(b, VALUE_LIST);
    for (size_t i = 0; list && i < intri->dict.count; i++) {
        const value *key = intri->dict.pair[i].key;
        const char *text = key->string.text;
        if (strncmp(text, "K_", 2) || !strncmp(text, "K_inv_", 6)) continue;
        if (!build_append(b, list, easymocap_camera(b, intri, extri, text + 2))) return NULL;
    }
    if (list && !list->list.count) return build_fail(b, SHERF_BAD_FILE, "no camera: K_NAME is missing");
    return list;
}

/* Reads a file; its text stays valid until mem_free(*data). */
static value *yaml_of(builder *b, const char *path, unsigned char **data) {
    size_t bytes;
    sherf_status status = file_read(b->c, path, text_bytes_max, data, &bytes);
    if (status) {
        b->status = b->status ? b->status : status;
        return NULL;
    }
    value *v = opencv_yaml_build(b, (const char *)*data, bytes);
    if (!v) failure_prefix(b->c, b->status, "%s", path);
    return v;
}

static sherf_status easymocap_read(context *c, const char *intri, const char *extri, document **out) {
    builder b;
    unsigned char *data[2] = {NULL, NULL};
    value *root = NULL;
    if (!build_start(&b, c, (size_t)512 << 20)) return b.status;
    const value *lens = yaml_of(&b, intri, &data[0]), *place = lens ? yaml_of(&b, extri, &data[1]) : NULL;
    value *cameras = place ? easymocap_cameras(&b, lens, place) : NULL;
    if (place && !cameras && b.status) failure_prefix(c, b.status, "%s", intri);
    if (cameras) root = build_value(&b, VALUE_DICT);
    if (root && !build_entry(&b, root, "cameras", cameras)) root = NULL;
    sherf_status status = build_finish(&b, root, out);
    mem_free(data[0]);
    mem_free(data[1]);
    return status;
}

/* ---- which ---- */

static const struct {
    const char *first, *second;
    sherf_status (*read)(context *c, const char *first, const char *second, document **out);
} pairs[] = {{"intri.yml", "extri.yml", easymocap_read}, {"cameras.txt", "images.txt", colmap_read}};

static const char *name_of(const char *path) {
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

/* Whether both of a pair are in the folder. */
static sherf_status pair_in(context *c, size_t pair, const char *folder, char first[PATH_LENGTH],
                            char second[PATH_LENGTH]) {
    sherf_status status = path_join(c, first, PATH_LENGTH, folder, pairs[pair].first);
    return status ? status : path_join(c, second, PATH_LENGTH, folder, pairs[pair].second);
}

static sherf_status read_folder(context *c, const char *path, document **out) {
    char first[PATH_LENGTH], second[PATH_LENGTH];
    for (size_t i = 0; i < COUNT_OF(pairs); i++) {
        sherf_status status = pair_in(c, i, path, first, second);
        if (status) return status;
        if (path_is_file(first) && path_is_file(second)) return pairs[i].read(c, first, second, out);
    }
    return failure(c, SHERF_BAD_FILE,
                   "%s: a folder without cameras: intri.yml and extri.yml (EasyMocap), or cameras.txt and "
                   "images.txt (COLMAP; its .bin files by colmap model_converter --output_type TXT)",
                   path);
}

sherf_status camera_document_read(context *c, const char *path, document **out) {
    char folder[PATH_LENGTH], first[PATH_LENGTH], second[PATH_LENGTH];
    const char *name = name_of(path);
    *out = NULL;
    if (path_is_folder(path)) return read_folder(c, path, out);
    if (!strcmp(name, "cameras.bin") || !strcmp(name, "images.bin"))
        return failure(
            c, SHERF_UNSUPPORTED,
            "%s: COLMAP's binary model: write it as text by colmap model_converter --output_type TXT", path);
    for (size_t i = 0; i < COUNT_OF(pairs); i++) {
        if (strcmp(name, pairs[i].first) && strcmp(name, pairs[i].second)) continue;
        if (name - path >= PATH_LENGTH) return failure(c, SHERF_BAD_FILE, "%.200s...: path too long", path);
        snprintf(folder, sizeof folder, "%.*s", name == path ? 1 : (int)(name - path),
                 name == path ? "." : path);
        sherf_status status = pair_in(c, i, folder, first, second);
        return status ? status : pairs[i].read(c, first, second, out);
    }
    return document_read(c, path, out, NULL);
}
