/* An avatar's file: safetensors with the observation, what of its bank is kept, and the weights. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avatar/avatar.h"

enum { NUMBERS = 72 + 10 + 9 + 3 + 9 + 9 + 3 };

/* The observation's pose and camera as one row of numbers and back. */
static void numbers_put(const sherf_avatar *a, float n[NUMBERS]) {
    memcpy(n, a->pose.poses_rad, 72 * sizeof *n);
    memcpy(n + 72, a->pose.shapes, 10 * sizeof *n);
    memcpy(n + 82, a->pose.R, 9 * sizeof *n);
    memcpy(n + 91, a->pose.Th_m, 3 * sizeof *n);
    memcpy(n + 94, a->camera.K, 9 * sizeof *n);
    memcpy(n + 103, a->camera.R, 9 * sizeof *n);
    memcpy(n + 112, a->camera.T_m, 3 * sizeof *n);
}

static sherf_status numbers_get(context *c, const float n[NUMBERS], sherf_avatar *a) {
    for (int i = 0; i < NUMBERS; i++)
        if (!isfinite(n[i])) return failure(c, SHERF_BAD_FILE, "tensor observation: not a finite number");
    memcpy(a->pose.poses_rad, n, 72 * sizeof *n);
    memcpy(a->pose.shapes, n + 72, 10 * sizeof *n);
    memcpy(a->pose.R, n + 82, 9 * sizeof *n);
    memcpy(a->pose.Th_m, n + 91, 3 * sizeof *n);
    memcpy(a->camera.K, n + 94, 9 * sizeof *n);
    memcpy(a->camera.R, n + 103, 9 * sizeof *n);
    memcpy(a->camera.T_m, n + 112, 3 * sizeof *n);
    a->camera.width_px = a->image_width;
    a->camera.height_px = a->image_height;
    return camera_check(c, &a->camera);
}

sherf_status sherf_avatar_save(sherf_context *c, const sherf_avatar *a, const char *path) {
    enum { OWN_ITEMS = 3 };
    const size_t max = OWN_ITEMS + (size_t)a->kept.count + (size_t)a->weights->count;
    float numbers[NUMBERS];
    char fingerprint[32], key[MODEL_KEY], *config = model_config_text(c, &a->config);
    safetensor_item *item = mem_zero(c, max, sizeof *item);
    sherf_status status = config && item ? SHERF_OK : SHERF_NO_MEMORY;
    size_t n = 0;
    if (status != SHERF_OK) goto done;
    numbers_put(a, numbers);
    snprintf(fingerprint, sizeof fingerprint, "%016llx", (unsigned long long)a->body_fingerprint);
    item[n++] = (safetensor_item){"observation", T_F32, 1, {NUMBERS}, numbers};
    item[n++] = (safetensor_item){"image", T_F32, 3, {a->image_height, a->image_width, 3}, a->image};
    if (a->picture)
        item[n++] =
            (safetensor_item){"picture", T_U8, 3, {a->picture_height, a->picture_width, 3}, a->picture};
    for (int i = 0; i < a->kept.count; i++) {
        const kept_array *k = &a->kept.array[i];
        item[n] = (safetensor_item){.name = k->name, .type = k->type, .rank = k->rank, .data = k->data};
        memcpy(item[n++].dim, k->dim, sizeof k->dim);
    }
    for (int i = 0; i < a->weights->count; i++) {
        const tensor *w = &a->weights->item[i]->value;
        item[n] = (safetensor_item){
            .name = a->weights->item[i]->name, .type = T_F32, .rank = w->rank, .data = w->data};
        memcpy(item[n++].dim, w->dim, sizeof w->dim);
    }
    model_metadata_key(a->config.kind, key);
    safetensor_metadata metadata[] = {
        {"format", "sherf-avatar"}, {"model", a->config.kind->name}, {key, config}, {"body", fingerprint}};
    status = safetensors_write(c, path, n, item, COUNT_OF(metadata), metadata);
done:
    mem_free(item);
    mem_free(config);
    return status;
}

static sherf_status observation_load(context *c, const safetensors *s, sherf_avatar *a) {
    kept_array image = {"image", T_F32, 3, {0, 0, 3}};
    int64_t numbers_dim[1] = {NUMBERS};
    float numbers[NUMBERS];
    sherf_status status = kept_array_read(c, s, &image);
    a->image = image.data;
    a->image_height = (int)image.dim[0];
    a->image_width = (int)image.dim[1];
    if (status == SHERF_OK) status = safetensors_floats(c, s, "observation", 1, numbers_dim, numbers);
    return status == SHERF_OK ? numbers_get(c, numbers, a) : status;
}

/* Avatars of small pictures, and older files, have none. */
static sherf_status picture_load(context *c, const safetensors *s, sherf_avatar *a) {
    enum { SIDE_MAX = 4096 };
    const safetensor *t = safetensors_find(s, "picture");
    if (!t) return SHERF_OK;
    if (t->type != T_U8 || t->rank != 3 || t->dim[2] != 3 || t->dim[0] < 2 || t->dim[1] < 2 ||
        t->dim[0] > SIDE_MAX || t->dim[1] > SIDE_MAX)
        return failure(c, SHERF_BAD_FILE, "tensor picture is of the wrong shape");
    const size_t bytes = (size_t)t->dim[0] * (size_t)t->dim[1] * 3;
    a->picture = mem_alloc(c, bytes, 1);
    a->picture_height = (int)t->dim[0];
    a->picture_width = (int)t->dim[1];
    if (!a->picture) return SHERF_NO_MEMORY;
    memcpy(a->picture, t->data, bytes);
    return SHERF_OK;
}

static sherf_status weights_load(context *c, const safetensors *s, sherf_avatar *a) {
    model *shape = NULL; /* names and shapes of this configuration */
    sherf_status status = model_shape(c, &a->config, &shape);
    if (status == SHERF_OK) status = avatar_weights(c, shape, &a->weights);
    for (int i = 0; status == SHERF_OK && i < a->weights->count; i++) {
        tensor *w = &a->weights->item[i]->value;
        status = safetensors_floats(c, s, a->weights->item[i]->name, w->rank, w->dim, w->data);
    }
    model_free(shape);
    return status;
}

sherf_status sherf_avatar_load(sherf_context *c, const char *path, const sherf_body *body,
                               sherf_avatar **out) {
    *out = NULL;
    safetensors *s = NULL;
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    sherf_avatar *a = avatar_new(c);
    const char *format = safetensors_metadata(s, "format");
    const char *fingerprint = safetensors_metadata(s, "body");
    if (!a)
        status = SHERF_NO_MEMORY;
    else if (!format || strcmp(format, "sherf-avatar") || !fingerprint)
        status =
            failure(c, SHERF_BAD_FILE, "not an avatar%s%s", format ? " but a " : "", format ? format : "");
    else if (strtoull(fingerprint, NULL, 16) != body->fingerprint)
        status = failure(c, SHERF_MISMATCH, "made with another body: give the body file it was made with");
    if (status == SHERF_OK) status = model_config_of_file(c, s, NULL, false, &a->config);
    if (status == SHERF_OK) status = observation_load(c, s, a);
    if (status == SHERF_OK) status = kept_read(c, s, &a->config, &a->kept);
    if (status == SHERF_OK) status = picture_load(c, s, a);
    if (status == SHERF_OK) status = weights_load(c, s, a);
    if (status == SHERF_OK) status = avatar_finish(c, body, a);
    safetensors_free(s);
    if (status == SHERF_OK) {
        *out = a;
        return SHERF_OK;
    }
    sherf_avatar_free(a);
    return failure_prefix(c, status, "%s", path);
}
