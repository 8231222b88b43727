/* cameras.json (RenderPeople, HuMMan): a person's cameras by name. */
#include <stdio.h>

#include "data/dataset.h"

static sherf_status cameras_parse(context *c, const char *name, int digits, const value *root,
                                  person_record *r) {
    char key[32];
    int views = 0;
    while (views < DATASET_VIEWS_MAX) {
        snprintf(key, sizeof key, "%s%0*d", name, digits, views);
        if (!value_get(root, key)) break;
        views++;
    }
    if (!views) return failure(c, SHERF_BAD_FILE, "no camera %s", key);
    r->camera = mem_zero(c, (size_t)views, sizeof *r->camera);
    if (!r->camera) return SHERF_NO_MEMORY;
    r->views = views;
    for (int v = 0; v < views; v++) {
        snprintf(key, sizeof key, "%s%0*d", name, digits, v);
        sherf_status status = parse_camera(c, value_get(root, key), NULL, NULL, &r->camera[v]);
        if (!status) status = parsed_camera_placed(c, &r->camera[v]);
        if (status) return failure_prefix(c, status, "%s", key);
    }
    return SHERF_OK;
}

sherf_status cameras_json_read(context *c, const char *folder, const char *name, int digits,
                               person_record *r) {
    char path[PATH_LENGTH];
    document *d = NULL;
    sherf_status status = path_join(c, path, sizeof path, folder, "cameras.json");
    if (status || (status = json_read(c, path, &d))) return status;
    status = cameras_parse(c, name, digits, d->root, r);
    if (status) failure_prefix(c, status, "%s", path);
    document_free(d);
    return status;
}
