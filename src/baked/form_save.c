/* Writes baked avatars' files: safetensors with the surface and its texture. */
#include "baked/form.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>

sherf_status baked_save(context *c, const sherf_avatar *a, const char *path) {
    const baked_form *f = a->formed;
    float numbers[BAKED_NUMBERS];
    char fingerprint[32];
    snprintf(fingerprint, sizeof fingerprint, "%016" PRIx64, a->body_fingerprint);
    observed_numbers(&a->picture[0], numbers);
    numbers[OBSERVED_NUMBERS] = (float)a->picture[0].camera.width_px;
    numbers[OBSERVED_NUMBERS + 1] = (float)a->picture[0].camera.height_px;
    safetensor_item item[9] = {
        {"observation", T_F32, 1, {BAKED_NUMBERS}, numbers},
        {"rest", T_F32, 2, {f->corners, 3}, f->rest},
        {"uv", T_F32, 2, {f->corners, 2}, f->uv},
        {"weight", T_F32, 2, {f->corners, 4}, f->weight},
        {"joint", T_U8, 2, {f->corners, 4}, f->joint},
        {"triangle", T_I32, 2, {f->triangles, 3}, f->triangle},
        {"texture.png", T_U8, 1, {(int64_t)f->png_bytes}, f->png},
    };
    size_t items = 7;
    if (f->fold) {
        item[items++] = (safetensor_item){"fold", T_F32, 2, {f->corners, 12}, f->fold};
        item[items++] = (safetensor_item){"fold_joint", T_U8, 2, {f->corners, 4}, f->fold_joint};
    }
    const safetensor_metadata metadata[] = {
        SAFETENSORS_CHECKSUM, {"format", BAKED_FORMAT}, {"version", "1"}, {"body", fingerprint}};
    return safetensors_write(c, path, items, item, COUNT_OF(metadata), metadata);
}
