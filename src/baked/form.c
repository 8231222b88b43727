/* Baked avatars: making one from an avatar, drawing, freeing. */
#include "baked/form.h"

#include <math.h>
#include <string.h>

#include "baked/person.h"
#include "io/image.h"

void baked_form_free(baked_form *f) {
    if (!f) return;
    mem_free(f->rest);
    mem_free(f->uv);
    mem_free(f->joint);
    mem_free(f->weight);
    mem_free(f->fold_joint);
    mem_free(f->fold);
    mem_free(f->triangle);
    for (int i = 0; i < BAKED_LEVELS; i++) mem_free(f->texture[i]);
    mem_free(f->png);
    mem_free(f);
}

/* Each texel is the mean of four. */
static void halve(const uint8_t *from, int side, uint8_t *to) {
    const size_t row = 3 * (size_t)side;
    for (int y = 0; y < side / 2; y++)
        for (int x = 0; x < side / 2; x++)
            for (size_t k = 0; k < 3; k++) {
                const uint8_t *p = from + 2 * (size_t)y * row + 6 * (size_t)x + k;
                to[3 * ((size_t)y * (size_t)(side / 2) + (size_t)x) + k] =
                    (uint8_t)((p[0] + p[3] + p[row] + p[row + 3] + 2) / 4);
            }
}

sherf_status baked_levels_make(context *c, baked_form *f) {
    for (int i = 1, side = f->side_px / 2; i < BAKED_LEVELS; i++, side /= 2) {
        if (!(f->texture[i] = mem_alloc(c, (size_t)side * (size_t)side, 3))) return SHERF_NO_MEMORY;
        halve(f->texture[i - 1], 2 * side, f->texture[i]);
    }
    return SHERF_OK;
}

static void corners_fill(const baked_person *p, baked_form *f) {
    const atlas *a = &p->atlas;
    for (size_t i = 0; i < (size_t)f->corners; i++) {
        const size_t v = a->vertex[i];
        memcpy(f->rest + 3 * i, p->surface.position + 3 * v, 3 * sizeof(float));
        memcpy(f->joint + 4 * i, p->skin.joint + 4 * v, 4);
        memcpy(f->weight + 4 * i, p->skin.weight + 4 * v, 4 * sizeof(float));
    }
    memcpy(f->uv, a->uv, 2 * (size_t)f->corners * sizeof(float));
    memcpy(f->triangle, a->triangle, 3 * (size_t)f->triangles * sizeof *f->triangle);
}

/* Sums pose_volume times the vector from the joint, over the body's vertices that a surface's vertex moves
 * with; keeps the four largest joints. */
static void fold_of(const body_model *body, const skin *s, size_t v, uint8_t joint[4], float fold[12]) {
    float sum[BODY_JOINTS][3] = {{0}}, size[BODY_JOINTS];
    for (size_t i = SKIN_NEAR * v; i < SKIN_NEAR * (v + 1); i++) {
        const size_t near = (size_t)s->near[i];
        for (int j = 1; j < BODY_JOINTS && s->share[i] > 0; j++) {
            const float k = s->share[i] * body->pose_volume[near * BODY_JOINTS + (size_t)j];
            for (size_t a = 0; a < 3; a++)
                sum[j][a] += k * (body->v_template[3 * near + a] - (float)body->joint_template[j][a]);
        }
    }
    for (int j = 0; j < BODY_JOINTS; j++)
        size[j] = sum[j][0] * sum[j][0] + sum[j][1] * sum[j][1] + sum[j][2] * sum[j][2];
    for (int i = 0; i < 4; i++) {
        int best = 0;
        for (int j = 1; j < BODY_JOINTS; j++)
            if (size[j] > size[best]) best = j;
        joint[i] = (uint8_t)best;
        for (int a = 0; a < 3; a++) fold[3 * i + a] = size[best] > 0 ? sum[best][a] : 0;
        size[best] = 0;
    }
}

static sherf_status folds_make(context *c, const body_model *body, const baked_person *p, baked_form *f) {
    if (!body->pose_volume) return SHERF_OK;
    f->fold_joint = mem_alloc(c, (size_t)f->corners, 4);
    f->fold = mem_alloc(c, (size_t)f->corners, 12 * sizeof *f->fold);
    if (!f->fold_joint || !f->fold) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < (size_t)f->corners; i++)
        fold_of(body, &p->skin, p->atlas.vertex[i], f->fold_joint + 4 * i, f->fold + 12 * i);
    return SHERF_OK;
}

static sherf_status form_of(context *c, const body_model *body, baked_person *p, baked_form *f) {
    f->corners = p->atlas.corners;
    f->triangles = p->surface.triangles;
    f->side_px = p->atlas.side_px;
    f->texture[0] = p->picture;
    p->picture = NULL;
    const size_t n = (size_t)f->corners;
    f->rest = mem_alloc(c, n, 3 * sizeof(float));
    f->uv = mem_alloc(c, n, 2 * sizeof(float));
    f->joint = mem_alloc(c, n, 4);
    f->weight = mem_alloc(c, n, 4 * sizeof(float));
    f->triangle = mem_alloc(c, (size_t)f->triangles, 3 * sizeof *f->triangle);
    if (!f->rest || !f->uv || !f->joint || !f->weight || !f->triangle) return SHERF_NO_MEMORY;
    corners_fill(p, f);
    sherf_status status = folds_make(c, body, p, f);
    if (status == SHERF_OK) status = baked_levels_make(c, f);
    if (status != SHERF_OK) return status;
    return png_to_memory(c, f->side_px, f->side_px, 3, f->texture[0], 6, &f->png, &f->png_bytes);
}

static sherf_status options_check(context *c, const sherf_bake_options *o) {
    if (o->resolution && (o->resolution < EXPORT_RESOLUTION_MIN || o->resolution > EXPORT_RESOLUTION_MAX))
        return failure(c, SHERF_BAD_ARGUMENT, "bake: %d cells, must be %d to %d", o->resolution,
                       EXPORT_RESOLUTION_MIN, EXPORT_RESOLUTION_MAX);
    if (o->triangles && (o->triangles < 100 || o->triangles > 1000000))
        return failure(c, SHERF_BAD_ARGUMENT, "bake: %d triangles, must be 100 to 1000000", o->triangles);
    if (o->texture_px &&
        (o->texture_px < BAKED_SIDE_MIN || o->texture_px > BAKED_SIDE_MAX || o->texture_px % 8))
        return failure(c, SHERF_BAD_ARGUMENT,
                       "bake: a texture of %d texels, must be %d to %d, a multiple of 8", o->texture_px,
                       BAKED_SIDE_MIN, BAKED_SIDE_MAX);
    return SHERF_OK;
}

sherf_status sherf_avatar_bake(sherf_context *c, const sherf_avatar *a, const sherf_body *body,
                               const sherf_bake_options *options, sherf_avatar **out) {
    const sherf_bake_options plain = {0}, *o = options ? options : &plain;
    baked_person p = {0};
    *out = NULL;
    if (a->form) return avatar_named(c, a, failure(c, SHERF_UNSUPPORTED, "this avatar is baked already"));
    sherf_status status = options_check(c, o);
    if (status != SHERF_OK) return status;
    const baked_options how = {.resolution = o->resolution ? o->resolution : BAKED_RESOLUTION,
                               .islands = BAKED_ISLANDS,
                               .triangles = o->triangles ? o->triangles : BAKED_TRIANGLES,
                               .texture_px = o->texture_px ? o->texture_px : BAKED_TEXTURE,
                               .detail = o->detail != SHERF_DETAIL_OFF};
    sherf_avatar *baked = avatar_new(c);
    baked_form *f = mem_zero(c, 1, sizeof *f);
    status = baked && f ? baked_person_make(c, a, body, &how, &p) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = form_of(c, body, &p, f);
    baked_person_free(&p);
    if (status != SHERF_OK) {
        baked_form_free(f);
        sherf_avatar_free(baked);
        return status;
    }
    baked->form = &baked_avatar_form;
    baked->formed = f;
    baked->body_fingerprint = a->body_fingerprint;
    baked->picture[0].pose = a->picture[0].pose;
    baked->picture[0].camera = a->picture[0].camera;
    *out = baked;
    return SHERF_OK;
}

static sherf_status render(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                           const sherf_camera *camera, const sherf_render_options *o, sherf_frame *frame) {
    static const float black[3] = {0, 0, 0};
    sherf_status status = o && o->exact ? avatar_needs_network(c, a, "exact frames need") : SHERF_OK;
    if (status == SHERF_OK) status = avatar_check_body(c, a, body);
    if (status != SHERF_OK) return status;
    return baked_draw(c, a->formed, body, pose, camera, o ? o->background : black, frame);
}

static void release(void *form) {
    baked_form_free(form);
}

const avatar_form baked_avatar_form = {
    .name = "baked", .render = render, .save = baked_save, .release = release};
