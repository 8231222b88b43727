/* Composites the person over the place, and applies tone curve and grain. */
#include "synth/people/people_photo.h"

#include <math.h>

/* Picks a few pixels' colours of the person, for things in the place. */
static void near_colors(place *p, const trace_picture *picture) {
    uint64_t key = random_key(p->key, "place.near", 0);
    int64_t pixels = (int64_t)picture->width * picture->height;
    for (int n = 0; n < PLACE_NEAR_COLORS; n++)
        for (uint64_t i = 0; i < 100; i++) {
            size_t at = (size_t)random_below(key, 100 * (uint64_t)n + i, pixels);
            for (size_t k = 0; k < 3; k++)
                p->near_color[n][k] = fminf(1, powf(fmaxf(0, picture->color[3 * at + k]), 1 / 2.2f));
            if (picture->alpha[at] > 0.9f) break;
        }
}

static void add_grain(uint64_t key, size_t values, uint8_t *rgb) {
    double strength = 0.3 + 1.7 * random_uniform(key, 0) * random_uniform(key, 1);
    for (size_t i = 0; i < values; i++) {
        double x = rgb[i] + strength * random_normal(key, i + 1) + 0.5;
        rgb[i] = (uint8_t)(x > 0 ? x < 255 ? x : 255 : 0);
    }
}

sherf_status people_photo(context *c, place *p, const trace_light *light, const dressed *d,
                          const float *const *position, const sherf_camera *camera, trace_picture *picture,
                          uint8_t *rgb, uint8_t *mask) {
    static const float black[3] = {0, 0, 0};
    trace_mesh mesh[DRESSED_MAX];
    trace_material material[DRESSED_MAX];
    const place_people people = {d->meshes, mesh, material, position};
    trace_picture behind = {0};
    size_t pixels = (size_t)picture->width * (size_t)picture->height;
    for (int i = 0; i < d->meshes; i++) {
        const dressed_mesh *part = &d->mesh[i];
        mesh[i] = (trace_mesh){.vertices = part->vertices,
                               .faces = part->triangles,
                               .face = part->triangle,
                               .uvs = part->uvs,
                               .uv = part->uv,
                               .face_uv = part->triangle_uv,
                               .rest = part->rest};
        material[i] = part->material;
    }
    near_colors(p, picture);
    sherf_status status = place_picture(c, p, light, &people, camera, &behind);
    if (status) return status;
    for (size_t i = 0; i < pixels; i++) {
        float through = 1 - picture->alpha[i];
        for (size_t k = 0; k < 3; k++) picture->color[3 * i + k] += through * behind.color[3 * i + k];
        mask[i] = picture->alpha[i] >= 0.5f ? 255 : 0;
        picture->alpha[i] = 1;
    }
    trace_picture_srgb(picture, black, rgb);
    for (size_t i = 0; i < pixels; i++) picture->alpha[i] = mask[i] ? 1 : 0;
    add_grain(random_key(p->key, "place.grain", 0), 3 * pixels, rgb);
    trace_picture_free(&behind);
    return SHERF_OK;
}
