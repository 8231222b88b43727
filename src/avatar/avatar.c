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
    if (a->form) a->form->release(a->formed);
    lazy_occupancy_free(a->occupancy);
    lazy_detail_free(a->detail);
    if (a->field_kind) a->field_kind->release(a->field);
    for (int i = 0; i < OBSERVED_PICTURES_MAX; i++) {
        mem_free(a->picture[i].image.data);
        mem_free(a->fine[i].data);
        posed_body_free(a->posed[i]);
    }
    observed_sheet_free(&a->sheet);
    parameters_free(a->weights);
    kept_free(&a->kept);
    mem_free(a->path);
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

sherf_status avatar_finish(context *c, const body_model *body, sherf_avatar *a) {
    a->body_fingerprint = body->fingerprint;
    sherf_status status = SHERF_OK;
    if (!a->sheet.body)
        status = observed_sheet_create(c, &a->config, body, a->pictures, a->picture, &a->sheet);
    for (int i = 0; i < a->pictures && a->pictures > 1 && status == SHERF_OK; i++) {
        const sherf_pose *p = &a->picture[i].pose;
        status = posed_body_create(c, body, p->poses_rad, p->shapes, p->R, p->Th_m, &a->posed[i]);
        if (status == SHERF_OK) a->posed[i]->blend_m = a->sheet.body->blend_m;
    }
    return status == SHERF_OK ? avatar_place(c, body, a) : status;
}

static sherf_status picture_keep(context *c, const sherf_observation *o, observed_picture *out) {
    const sherf_image *image = sherf_observation_image(o);
    const size_t n = (size_t)image->width * (size_t)image->height * (size_t)image->channels;
    *out = (observed_picture){*image, *sherf_observation_camera(o), *sherf_observation_pose(o)};
    out->image.data = mem_alloc(c, n, sizeof(float));
    if (!out->image.data) return SHERF_NO_MEMORY;
    memcpy(out->image.data, image->data, n * sizeof(float));
    return SHERF_OK;
}

static sherf_status fine_keep(context *c, const sherf_image *fine, fine_picture *out) {
    const size_t n = (size_t)fine->width * (size_t)fine->height * 3;
    if (!fine->data) return SHERF_OK;
    *out = (fine_picture){fine->width, fine->height, mem_alloc(c, n, 1)};
    if (!out->data) return SHERF_NO_MEMORY;
    for (size_t i = 0; i < n; i++) out->data[i] = float_to_u8(fine->data[i]);
    return SHERF_OK;
}

static sherf_status pictures_keep(context *c, int count, const sherf_observation *const *observation,
                                  sherf_avatar *a) {
    sherf_status status = SHERF_OK;
    a->pictures = count;
    for (int i = 0; i < count && status == SHERF_OK; i++) {
        status = picture_keep(c, observation[i], &a->picture[i]);
        if (status == SHERF_OK) status = fine_keep(c, &observation[i]->fine, &a->fine[i]);
    }
    return status;
}

/* Checks that each picture shows the person. */
static sherf_status pictures_check(context *c, const body_model *body, const observation_geometry *g,
                                   int count, const sherf_observation *const *observation) {
    sherf_status status = SHERF_OK;
    if (count == 1) return body_in_picture(c, body, g->body, &g->camera, observation[0]->mask);
    for (int i = 0; i < count && status == SHERF_OK; i++) {
        status = observation_check_body(c, observation[i], body);
        if (status != SHERF_OK) failure_prefix(c, status, "picture %d", i + 1);
    }
    return status;
}

sherf_status avatar_create(context *c, const model *m, const body_model *body, int count,
                           const sherf_observation *const *observation, bool batch_statistics,
                           sherf_avatar **out) {
    *out = NULL;
    observation_geometry *g = NULL;
    tape *t = NULL;
    model_bank bank;
    if (m->weights->memory != backend_of(c)->memory)
        return failure(c, SHERF_MISMATCH,
                       "the model was loaded for another device than that of this context");
    if (count < 1 || count > OBSERVED_PICTURES_MAX)
        return failure(c, SHERF_BAD_ARGUMENT, "%d pictures of a person: 1 to %d can be read", count,
                       OBSERVED_PICTURES_MAX);
    sherf_avatar *a = avatar_new(c);
    if (!a) return SHERF_NO_MEMORY;
    a->config = m->config;
    sherf_status status = pictures_keep(c, count, observation, a);
    if (status == SHERF_OK)
        status = observation_geometry_of(c, &m->config, body, count, a->picture, false, &g);
    if (status == SHERF_OK) status = pictures_check(c, body, g, count, observation);
    if (status != SHERF_OK) goto done;
    t = tape_create(c, (tape_options){.backend = backend_of(c),
                                      .bf16 = c->precision == SHERF_PRECISION_BF16,
                                      .batch_statistics = batch_statistics});
    status = t ? model_encode(t, m, body, g, &bank) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = avatar_weights(c, m, &a->weights);
    if (status == SHERF_OK) status = kept_make(c, m, g, &bank, &a->kept);
    if (status != SHERF_OK) goto done;
    a->sheet = (observed_sheet){g->width, g->height, g->image, g->camera, g->body};
    g->image = NULL;
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

sherf_status sherf_avatar_create_several(sherf_context *c, const sherf_model *m, const sherf_body *body,
                                         int count, const sherf_observation *const *observation,
                                         sherf_avatar **out) {
    return avatar_create(c, m, body, count, observation, false, out);
}

sherf_status sherf_avatar_create(sherf_context *c, const sherf_model *m, const sherf_body *body,
                                 const sherf_observation *observation, sherf_avatar **out) {
    return sherf_avatar_create_several(c, m, body, 1, &observation, out);
}

const sherf_pose *sherf_avatar_pose(const sherf_avatar *a) {
    return &a->picture[0].pose;
}
const sherf_camera *sherf_avatar_camera(const sherf_avatar *a) {
    return &a->picture[0].camera;
}
