/* An avatar's file: safetensors with the observation, the part of its bank that is kept, and the weights. */
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "avatar/avatar.h"

enum { ITEM_NAME = 24 };
/* Programs that know only one picture refuse avatars of several. */
static const char *const format_one = "sherf-avatar", *const format_several = "sherf-avatar-of-several";

void observed_numbers(const observed_picture *p, float n[OBSERVED_NUMBERS]) {
    memcpy(n, p->pose.poses_rad, 72 * sizeof *n);
    memcpy(n + 72, p->pose.shapes, 10 * sizeof *n);
    memcpy(n + 82, p->pose.R, 9 * sizeof *n);
    memcpy(n + 91, p->pose.Th_m, 3 * sizeof *n);
    memcpy(n + 94, p->camera.K, 9 * sizeof *n);
    memcpy(n + 103, p->camera.R, 9 * sizeof *n);
    memcpy(n + 112, p->camera.T_m, 3 * sizeof *n);
}

sherf_status observed_from_numbers(context *c, const char *name, const float n[OBSERVED_NUMBERS], int width,
                                   int height, observed_picture *p) {
    for (int i = 0; i < OBSERVED_NUMBERS; i++)
        if (!isfinite(n[i])) return failure(c, SHERF_BAD_FILE, "tensor %s: not a finite number", name);
    memcpy(p->pose.poses_rad, n, 72 * sizeof *n);
    memcpy(p->pose.shapes, n + 72, 10 * sizeof *n);
    memcpy(p->pose.R, n + 82, 9 * sizeof *n);
    memcpy(p->pose.Th_m, n + 91, 3 * sizeof *n);
    memcpy(p->camera.K, n + 94, 9 * sizeof *n);
    memcpy(p->camera.R, n + 103, 9 * sizeof *n);
    memcpy(p->camera.T_m, n + 112, 3 * sizeof *n);
    p->camera.width_px = width;
    p->camera.height_px = height;
    return camera_check(c, &p->camera);
}

/* "image", "image.1", "image.2", ... */
static const char *name_of(const char *what, int picture, char name[ITEM_NAME]) {
    if (!picture) return what;
    snprintf(name, ITEM_NAME, "%s.%d", what, picture);
    return name;
}

/* Writes the tensors of one picture: at most 3. */
typedef struct {
    float numbers[OBSERVED_NUMBERS];
    char name[3][ITEM_NAME];
} picture_items;
static size_t picture_put(const sherf_avatar *a, int i, picture_items *room, safetensor_item *item) {
    const sherf_image *image = &a->picture[i].image;
    const fine_picture *fine = &a->fine[i];
    observed_numbers(&a->picture[i], room->numbers);
    item[0] = (safetensor_item){
        name_of("observation", i, room->name[0]), T_F32, 1, {OBSERVED_NUMBERS}, room->numbers};
    item[1] = (safetensor_item){
        name_of("image", i, room->name[1]), T_F32, 3, {image->height, image->width, 3}, image->data};
    if (!fine->data) return 2;
    item[2] = (safetensor_item){
        name_of("picture", i, room->name[2]), T_U8, 3, {fine->height, fine->width, 3}, fine->data};
    return 3;
}

sherf_status sherf_avatar_save(sherf_context *c, const sherf_avatar *a, const char *path) {
    if (a->form) return a->form->save(c, a, path);
    const size_t max = 3 * OBSERVED_PICTURES_MAX + (size_t)a->kept.count + (size_t)a->weights->count;
    picture_items pictures[OBSERVED_PICTURES_MAX];
    char fingerprint[32], variant[32], key[MODEL_KEY], *config = model_config_text(c, &a->config);
    safetensor_item *item = mem_zero(c, max, sizeof *item);
    sherf_status status = config && item ? SHERF_OK : SHERF_NO_MEMORY;
    size_t n = 0;
    if (status != SHERF_OK) goto done;
    snprintf(fingerprint, sizeof fingerprint, "%016llx", (unsigned long long)a->body_fingerprint);
    snprintf(variant, sizeof variant, "%llu", (unsigned long long)a->variant);
    for (int i = 0; i < a->pictures; i++) n += picture_put(a, i, &pictures[i], item + n);
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
    safetensor_metadata metadata[] = {SAFETENSORS_CHECKSUM,
                                      {"format", a->pictures > 1 ? format_several : format_one},
                                      {"model", a->config.kind->name},
                                      {key, config},
                                      {"body", fingerprint},
                                      {"variant", variant}};
    const size_t metadata_count = COUNT_OF(metadata) - !a->variant;
    status = safetensors_write(c, path, n, item, metadata_count, metadata);
done:
    mem_free(item);
    mem_free(config);
    return status;
}

/* Missing in avatars of small pictures and in older files. */
static sherf_status fine_load(context *c, const safetensors *s, const char *name, fine_picture *out) {
    enum { SIDE_MAX = 4096 };
    const safetensor *t = safetensors_find(s, name);
    if (!t) return SHERF_OK;
    if (t->type != T_U8 || t->rank != 3 || t->dim[2] != 3 || t->dim[0] < 2 || t->dim[1] < 2 ||
        t->dim[0] > SIDE_MAX || t->dim[1] > SIDE_MAX)
        return failure(c, SHERF_BAD_FILE, "tensor %s is of the wrong shape", name);
    const size_t bytes = (size_t)t->dim[0] * (size_t)t->dim[1] * 3;
    *out = (fine_picture){(int)t->dim[1], (int)t->dim[0], mem_alloc(c, bytes, 1)};
    if (!out->data) return SHERF_NO_MEMORY;
    memcpy(out->data, t->data, bytes);
    return SHERF_OK;
}

static sherf_status picture_load(context *c, const safetensors *s, int i, sherf_avatar *a) {
    char room[ITEM_NAME];
    kept_array image = {name_of("image", i, room), T_F32, 3, {0, 0, 3}};
    const int64_t numbers_dim[1] = {OBSERVED_NUMBERS};
    float numbers[OBSERVED_NUMBERS];
    observed_picture *p = &a->picture[i];
    sherf_status status = kept_array_read(c, s, &image);
    p->image = (sherf_image){(int)image.dim[1], (int)image.dim[0], 3, image.data};
    const char *name = name_of("observation", i, room);
    if (status == SHERF_OK) status = safetensors_floats(c, s, name, 1, numbers_dim, numbers);
    if (status == SHERF_OK)
        status = observed_from_numbers(c, name, numbers, p->image.width, p->image.height, p);
    return status == SHERF_OK ? fine_load(c, s, name_of("picture", i, room), &a->fine[i]) : status;
}

static sherf_status pictures_load(context *c, const safetensors *s, bool several, sherf_avatar *a) {
    char room[ITEM_NAME];
    sherf_status status = SHERF_OK;
    do {
        status = picture_load(c, s, a->pictures++, a);
    } while (several && status == SHERF_OK && a->pictures < OBSERVED_PICTURES_MAX &&
             safetensors_find(s, name_of("observation", a->pictures, room)));
    return status;
}

static sherf_status variant_load(context *c, const safetensors *s, sherf_avatar *a) {
    const char *text = safetensors_metadata(s, "variant");
    char *end;
    if (!text) return SHERF_OK;
    errno = 0;
    a->variant = strtoull(text, &end, 10);
    if (errno || *end || end == text || *text < '0' || *text > '9')
        return failure(c, SHERF_BAD_FILE, "variant \"%.40s\" is no whole number", text);
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

sherf_status avatar_read(context *c, const safetensors *s, const body_model *body, sherf_avatar **out) {
    sherf_avatar *a = avatar_new(c);
    const char *format = safetensors_metadata(s, "format");
    const char *fingerprint = safetensors_metadata(s, "body");
    sherf_status status = SHERF_OK;
    if (!a)
        status = SHERF_NO_MEMORY;
    else if (!format || (strcmp(format, format_one) && strcmp(format, format_several)) || !fingerprint)
        status =
            failure(c, SHERF_BAD_FILE, "not an avatar%s%s", format ? " but a " : "", format ? format : "");
    else if (strtoull(fingerprint, NULL, 16) != body->fingerprint)
        status = failure(c, SHERF_MISMATCH, "made with another body: give the body file it was made with");
    if (status == SHERF_OK) status = model_config_of_file(c, s, NULL, false, &a->config);
    if (status == SHERF_OK) status = pictures_load(c, s, !strcmp(format, format_several), a);
    if (status == SHERF_OK) status = kept_read(c, s, &a->config, &a->kept);
    if (status == SHERF_OK) status = variant_load(c, s, a);
    if (status == SHERF_OK) status = weights_load(c, s, a);
    if (status == SHERF_OK) status = avatar_finish(c, body, a);
    if (status == SHERF_OK)
        *out = a;
    else
        sherf_avatar_free(a);
    return status;
}
