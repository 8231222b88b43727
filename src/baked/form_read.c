/* Reads avatars' files: sherf_avatar_load, and baked avatars (form_save.c). */
#include "baked/form.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "io/image.h"
#include "io/safetensors.h"

/* Finds a tensor of N x width with finite values, or fails. *rows: its number of rows; if not 0, the number
 * it must have. */
static sherf_status array_read(context *c, const safetensors *s, const char *name, dtype type, int64_t width,
                               int64_t *rows, void **out) {
    const safetensor *t = safetensors_find(s, name);
    if (!t || t->type != type || t->rank != 2 || t->dim[1] != width || t->dim[0] < 3 ||
        t->dim[0] > BAKED_CORNERS_MAX || (*rows && t->dim[0] != *rows))
        return failure(c, SHERF_BAD_FILE, "tensor %s is missing or of the wrong shape", name);
    *rows = t->dim[0];
    const size_t n = (size_t)(t->dim[0] * width), size = type == T_U8 ? 1 : 4;
    if (!(*out = mem_alloc(c, n, size))) return SHERF_NO_MEMORY;
    memcpy(*out, t->data, n * size);
    for (size_t i = 0; i < n && type == T_F32; i++) {
        const float x = ((const float *)*out)[i];
        if (!(fabsf(x) <= 1e4f))
            return failure(c, SHERF_BAD_FILE, "tensor %s: number %zu is not finite or far too large", name,
                           i);
    }
    return SHERF_OK;
}

/* Checks every index and weight that a frame relies on. */
static sherf_status form_check(context *c, const baked_form *f) {
    for (int64_t i = 0; i < 4 * f->corners; i++)
        if (f->joint[i] >= BODY_JOINTS)
            return failure(c, SHERF_BAD_FILE, "tensor joint: corner %" PRId64 " moves with joint %d of %d",
                           i / 4, f->joint[i], BODY_JOINTS);
    for (int64_t i = 0; i < 4 * f->corners && f->fold; i++)
        if (f->fold_joint[i] >= BODY_JOINTS)
            return failure(c, SHERF_BAD_FILE,
                           "tensor fold_joint: corner %" PRId64 " bends with joint %d of %d", i / 4,
                           f->fold_joint[i], BODY_JOINTS);
    for (int64_t i = 0; i < f->corners; i++) {
        const float *w = f->weight + 4 * i, sum = w[0] + w[1] + w[2] + w[3];
        if (!(w[0] >= 0 && w[1] >= 0 && w[2] >= 0 && w[3] >= 0 && fabsf(sum - 1) < 1e-3f))
            return failure(c, SHERF_BAD_FILE, "tensor weight: those of corner %" PRId64 " do not sum to 1",
                           i);
    }
    for (int64_t i = 0; i < 3 * f->triangles; i++)
        if (f->triangle[i] >= f->corners)
            return failure(c, SHERF_BAD_FILE,
                           "tensor triangle: triangle %" PRId64 " has corner %" PRIu32 " of %" PRId64, i / 3,
                           f->triangle[i], f->corners);
    return SHERF_OK;
}

static sherf_status texture_read(context *c, const safetensors *s, baked_form *f) {
    const safetensor *t = safetensors_find(s, "texture.png");
    image_u8 picture = {0};
    if (!t || t->type != T_U8 || t->rank != 1 || t->dim[0] < 8)
        return failure(c, SHERF_BAD_FILE, "tensor texture.png is missing or of the wrong shape");
    f->png_bytes = (size_t)t->dim[0];
    if (!(f->png = mem_alloc(c, f->png_bytes, 1))) return SHERF_NO_MEMORY;
    memcpy(f->png, t->data, f->png_bytes);
    sherf_status status = image_parse(c, f->png, f->png_bytes, 0, &picture);
    if (status == SHERF_OK && (picture.width != picture.height || picture.width < BAKED_SIDE_MIN ||
                               picture.width > BAKED_SIDE_MAX || picture.width % 8))
        status = failure(c, SHERF_BAD_FILE, "%d x %d texels: must be a square of %d to %d, a multiple of 8",
                         picture.width, picture.height, BAKED_SIDE_MIN, BAKED_SIDE_MAX);
    if (status == SHERF_OK) status = image_parse(c, f->png, f->png_bytes, 3, &picture);
    if (status != SHERF_OK) return failure_prefix(c, status, "tensor texture.png");
    f->side_px = picture.width;
    f->texture[0] = picture.data;
    return baked_levels_make(c, f);
}

static sherf_status observation_read(context *c, const safetensors *s, observed_picture *out) {
    const int64_t dim[1] = {BAKED_NUMBERS};
    float n[BAKED_NUMBERS];
    sherf_status status = safetensors_floats(c, s, "observation", 1, dim, n);
    if (status != SHERF_OK) return status;
    const float *size = n + OBSERVED_NUMBERS;
    if (!isfinite(size[0]) || !isfinite(size[1]))
        return failure(c, SHERF_BAD_FILE, "tensor observation: not a finite number");
    if (!(size[0] >= 1 && size[0] <= 32768 && size[1] >= 1 && size[1] <= 32768))
        return failure(c, SHERF_BAD_FILE, "tensor observation: a picture of %g x %g", (double)size[0],
                       (double)size[1]);
    return observed_from_numbers(c, "observation", n, (int)size[0], (int)size[1], out);
}

static sherf_status form_read(context *c, const safetensors *s, baked_form *f) {
    sherf_status status = array_read(c, s, "rest", T_F32, 3, &f->corners, (void **)&f->rest);
    if (status == SHERF_OK) status = array_read(c, s, "uv", T_F32, 2, &f->corners, (void **)&f->uv);
    if (status == SHERF_OK) status = array_read(c, s, "weight", T_F32, 4, &f->corners, (void **)&f->weight);
    if (status == SHERF_OK) status = array_read(c, s, "joint", T_U8, 4, &f->corners, (void **)&f->joint);
    if (status == SHERF_OK)
        status = array_read(c, s, "triangle", T_I32, 3, &f->triangles, (void **)&f->triangle);
    if (status == SHERF_OK && (safetensors_find(s, "fold") || safetensors_find(s, "fold_joint"))) {
        status = array_read(c, s, "fold", T_F32, 12, &f->corners, (void **)&f->fold);
        if (status == SHERF_OK)
            status = array_read(c, s, "fold_joint", T_U8, 4, &f->corners, (void **)&f->fold_joint);
    }
    if (status == SHERF_OK) status = form_check(c, f);
    return status == SHERF_OK ? texture_read(c, s, f) : status;
}

sherf_status baked_read(context *c, const safetensors *s, const body_model *body, sherf_avatar **out) {
    *out = NULL;
    const char *fingerprint = safetensors_metadata(s, "body"), *version = safetensors_metadata(s, "version");
    if (!version || strcmp(version, "1"))
        return failure(c, SHERF_UNSUPPORTED, "a baked avatar of version %.20s: this program reads version 1",
                       version ? version : "?");
    if (!fingerprint || strtoull(fingerprint, NULL, 16) != body->fingerprint)
        return failure(c, SHERF_MISMATCH, "made with another body: give the body file it was made with");
    sherf_avatar *a = avatar_new(c);
    baked_form *f = mem_zero(c, 1, sizeof *f);
    sherf_status status = a && f ? observation_read(c, s, &a->picture[0]) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = form_read(c, s, f);
    if (status != SHERF_OK) {
        baked_form_free(f);
        sherf_avatar_free(a);
        return status;
    }
    a->form = &baked_avatar_form;
    a->formed = f;
    a->body_fingerprint = body->fingerprint;
    *out = a;
    return SHERF_OK;
}

/* For the messages of later errors. */
static sherf_status keep_path(context *c, const char *path, sherf_avatar **a) {
    const size_t bytes = strlen(path) + 1;
    (*a)->path = mem_alloc(c, bytes, 1);
    if ((*a)->path) {
        memcpy((*a)->path, path, bytes);
        return SHERF_OK;
    }
    sherf_avatar_free(*a);
    *a = NULL;
    return SHERF_NO_MEMORY;
}

sherf_status sherf_avatar_load(sherf_context *c, const char *path, const sherf_body *body,
                               sherf_avatar **out) {
    safetensors *s = NULL;
    *out = NULL;
    sherf_status status = safetensors_read(c, path, &s);
    if (status != SHERF_OK) return status;
    const char *format = safetensors_metadata(s, "format");
    status =
        format && !strcmp(format, BAKED_FORMAT) ? baked_read(c, s, body, out) : avatar_read(c, s, body, out);
    safetensors_free(s);
    if (status != SHERF_OK) return failure_prefix(c, status, "%s", path);
    return keep_path(c, path, out);
}
