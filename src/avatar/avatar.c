/* Avatars made of an observation: encoded once, with the weights that queries read. */
#include <string.h>

#include "avatar/detail.h"
#include "data/data.h"

sherf_avatar *avatar_new(context *c) {
    sherf_avatar *a = mem_zero(c, 1, sizeof *a);
    if (!a) return NULL;
    a->occupancy = lazy_occupancy_create(c);
    a->detail = lazy_detail_create(c);
    if (a->occupancy && a->detail) return a;
    sherf_avatar_free(a);
    return NULL;
}

void sherf_avatar_free(sherf_avatar *a) {
    if (!a) return;
    lazy_occupancy_free(a->occupancy);
    lazy_detail_free(a->detail);
    if (a->field_kind) a->field_kind->release(a->field);
    mem_free(a->picture);
    mem_free(a->image);
    posed_body_free(a->observed);
    parameters_free(a->weights);
    kept_free(&a->kept);
    mem_free(a);
}

sherf_status avatar_weights(context *c, const model *m, parameters **out) {
    const parameters *like = m->weights;
    parameters *p = *out = parameters_create(c);
    if (!p) return SHERF_NO_MEMORY;
    for (int i = 0; i < like->count; i++) {
        const parameter *q = like->item[i];
        if (model_is_queried(m->config.kind, q->name) &&
            !parameter_add(c, p, q->buffer, q->value.rank, q->value.dim, "%s", q->name))
            return SHERF_NO_MEMORY;
    }
    sherf_status status = parameters_lay_out(c, p);
    for (int i = 0; status == SHERF_OK && i < p->count; i++) {
        tensor *to = &p->item[i]->value, *from = &parameter_find(like, p->item[i]->name)->value;
        status = tensor_download(c, from, to->data);
    }
    return status;
}

static void *copy_of(context *c, const void *data, size_t count, size_t size) {
    void *p = mem_alloc(c, count, size);
    if (p) memcpy(p, data, count * size);
    return p;
}

sherf_status avatar_finish(context *c, const body_model *body, sherf_avatar *a) {
    a->body_fingerprint = body->fingerprint;
    if (!a->observed) {
        sherf_status status =
            observed_body_create(c, &a->config, body, &a->pose, &a->camera, a->image, &a->observed);
        if (status != SHERF_OK) return status;
    }
    return avatar_place(c, body, a);
}

static sherf_status image_keep(context *c, const observation_geometry *g, sherf_avatar *a) {
    a->image_width = g->width;
    a->image_height = g->height;
    a->image = copy_of(c, g->image, (size_t)g->width * (size_t)g->height * 3, sizeof(float));
    return a->image ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status picture_keep(context *c, const sherf_image *fine, sherf_avatar *a) {
    const size_t n = (size_t)fine->width * (size_t)fine->height * 3;
    if (!fine->data) return SHERF_OK;
    a->picture = mem_alloc(c, n, 1);
    if (!a->picture) return SHERF_NO_MEMORY;
    a->picture_width = fine->width;
    a->picture_height = fine->height;
    for (size_t i = 0; i < n; i++) a->picture[i] = float_to_u8(fine->data[i]);
    return SHERF_OK;
}

sherf_status sherf_avatar_create(sherf_context *c, const sherf_model *m, const sherf_body *body,
                                 const sherf_observation *observation, sherf_avatar **out) {
    *out = NULL;
    observation_geometry *g = NULL;
    tape *t = NULL;
    model_bank bank;
    if (m->weights->memory != backend_of(c)->memory)
        return failure(c, SHERF_MISMATCH,
                       "the model was loaded for another device than that of this context");
    sherf_avatar *a = avatar_new(c);
    if (!a) return SHERF_NO_MEMORY;
    a->config = m->config;
    a->pose = *sherf_observation_pose(observation);
    a->camera = *sherf_observation_camera(observation);
    sherf_status status = observation_geometry_create(
        c, &m->config, body, sherf_observation_image(observation), &a->camera, &a->pose, false, &g);
    if (status == SHERF_OK) status = body_in_picture(c, body, g->body, &a->camera, observation->mask);
    if (status != SHERF_OK) goto done;
    t = tape_create(c, (tape_options){backend_of(c), false, false, c->precision == SHERF_PRECISION_BF16});
    status = t ? model_encode(t, m, body, g, &bank) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = avatar_weights(c, m, &a->weights);
    if (status == SHERF_OK) status = image_keep(c, g, a);
    if (status == SHERF_OK) status = kept_make(c, m, g, &bank, &a->kept);
    if (status == SHERF_OK) status = picture_keep(c, &observation->fine, a);
    if (status != SHERF_OK) goto done;
    a->observed = g->body;
    g->body = NULL;
    status = avatar_finish(c, body, a);
done:
    tape_free(t);
    observation_geometry_free(g);
    if (status == SHERF_OK)
        *out = a;
    else
        sherf_avatar_free(a);
    return status;
}

const sherf_pose *sherf_avatar_pose(const sherf_avatar *a) {
    return &a->pose;
}
const sherf_camera *sherf_avatar_camera(const sherf_avatar *a) {
    return &a->camera;
}
