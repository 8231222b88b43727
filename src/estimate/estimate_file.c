/* Writes an estimate as a folder to look at and correct: an observation (docs/observation.md) and an
 * overlay. */
#include <cjson/cJSON.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "base/path.h"
#include "data/silhouette.h"
#include "estimate/estimate.h"
#include "io/image.h"

sherf_status estimate_draw(context *c, const sherf_estimate *e, const body_model *body, const char *path) {
    const size_t n = (size_t)e->photo.width * (size_t)e->photo.height;
    sherf_observation o = {.camera = e->fit.camera, .pose = e->fit.pose};
    o.image = (sherf_image){e->photo.width, e->photo.height, 3, mem_alloc(c, n, 3 * sizeof(float))};
    o.mask = mem_alloc(c, n, 1);
    sherf_status status = o.image.data && o.mask ? SHERF_OK : SHERF_NO_MEMORY;
    for (size_t i = 0; !status && i < 3 * n; i++)
        o.image.data[i] = e->photo.data[i] * (0.35f + 0.65f * e->mask.data[i / 3]);
    if (!status) memset(o.mask, 1, n);
    if (!status) status = silhouette_draw(c, &o, body, path);
    mem_free(o.image.data);
    mem_free(o.mask);
    return status;
}

sherf_status sherf_estimate_overlay(sherf_context *c, const sherf_estimate *e, const sherf_body *body,
                                    const char *path) {
    return estimate_draw(c, e, body, path);
}

static cJSON *numbers(const float *from, int count) {
    double as_read[72];
    for (int i = 0; i < count; i++) as_read[i] = (double)from[i];
    return cJSON_CreateDoubleArray(as_read, count);
}

static cJSON *matrix(const float *from) {
    cJSON *rows = cJSON_CreateArray();
    for (int i = 0; i < 3; i++) cJSON_AddItemToArray(rows, numbers(from + 3 * i, 3));
    return rows;
}

/* NULL: out of memory. */
static char *observation_text(const sherf_estimate *e) {
    const sherf_camera *k = &e->fit.camera;
    const sherf_pose *p = &e->fit.pose;
    cJSON *root = cJSON_CreateObject(), *camera = cJSON_CreateObject(), *body = cJSON_CreateObject();
    cJSON_AddStringToObject(root, "image", "image.png");
    cJSON_AddStringToObject(root, "mask", "mask.png");
    cJSON_AddItemToObject(camera, "K", matrix(k->K));
    cJSON_AddItemToObject(camera, "R", matrix(k->R));
    cJSON_AddItemToObject(camera, "T", numbers(k->T_m, 3));
    cJSON_AddNumberToObject(camera, "width", k->width_px);
    cJSON_AddNumberToObject(camera, "height", k->height_px);
    cJSON_AddItemToObject(root, "camera", camera);
    cJSON_AddItemToObject(body, "global_orient", numbers(p->poses_rad, 3));
    cJSON_AddItemToObject(body, "body_pose", numbers(p->poses_rad + 3, 69));
    cJSON_AddItemToObject(body, "betas", numbers(p->shapes, 10));
    cJSON_AddItemToObject(body, "R", matrix(p->R));
    cJSON_AddItemToObject(body, "transl", numbers(p->Th_m, 3));
    cJSON_AddItemToObject(root, "body", body);
    char *text = cJSON_Print(root);
    cJSON_Delete(root);
    return text;
}

/* ---- the folder ---- */
enum { PARTS = 3 };
typedef struct {
    const char *name;
    uint8_t *data;
    size_t bytes;
} part;

static sherf_status to_png(context *c, const sherf_image *image, part *out) {
    const size_t n = (size_t)image->width * (size_t)image->height * (size_t)image->channels;
    uint8_t *data = mem_alloc(c, n, 1);
    if (!data) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) data[i] = float_to_u8(image->data[i]);
    sherf_status status = png_to_memory(c, image->width, image->height, image->channels, data,
                                        png_level(image->width, image->height), &out->data, &out->bytes);
    mem_free(data);
    return status;
}

/* All of them appear, or none: each is on the disk before the first is put in place. */
static sherf_status write_parts(context *c, const char *folder, const part *parts) {
    sherf_status status = SHERF_OK;
    char path[PATH_LENGTH];
    output_file *out = mem_zero(c, PARTS, sizeof *out);
    if (!out) return SHERF_NO_MEMORY;
    for (int i = 0; !status && i < PARTS; i++) {
        if (snprintf(path, sizeof path, "%s/%s", folder, parts[i].name) >= (int)sizeof path)
            status = failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", folder);
        if (!status) status = output_open(c, path, &out[i]);
        if (!status) status = output_write(c, &out[i], parts[i].data, parts[i].bytes);
        if (!status && fflush(out[i].file))
            status = failure(c, SHERF_WRITE_FAILED, "%s: cannot be written: %s", path, strerror(errno));
    }
    for (int i = 0; !status && i < PARTS; i++) status = output_commit(c, &out[i]);
    for (int i = 0; i < PARTS; i++) output_abort(&out[i]);
    mem_free(out);
    return status;
}

sherf_status sherf_estimate_save(sherf_context *c, const sherf_estimate *e, const sherf_body *body,
                                 const char *folder) {
    char path[PATH_LENGTH];
    const bool fresh = !path_is_folder(folder);
    /* the JSON last: a folder without it is no observation */
    part parts[PARTS] = {{"image.png"}, {"mask.png"}, {"observation.json"}};
    char *text = observation_text(e);
    if (!text) return failure(c, SHERF_NO_MEMORY, "out of memory: an observation as text");
    sherf_status status = to_png(c, &e->color, &parts[0]);
    if (!status) status = to_png(c, &e->mask, &parts[1]);
    parts[2].data = (uint8_t *)text;
    parts[2].bytes = strlen(text);
    if (!status && snprintf(path, sizeof path, "%s/overlay.png", folder) >= (int)sizeof path)
        status = failure(c, SHERF_BAD_ARGUMENT, "%.200s...: path too long", folder);
    if (!status) status = folder_make(c, folder);
    if (!status) status = estimate_draw(c, e, body, path);
    if (!status) status = write_parts(c, folder, parts);
    if (status && fresh) { /* removes the folder made for it */
        remove(path);
        remove(folder);
    }
    for (int i = 0; i < 2; i++) mem_free(parts[i].data);
    cJSON_free(text);
    return status;
}
