/* Avatars: the feature bank of one observation with the weights that queries read, and the frames made from
 * it.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "data/data.h"
#include "io/safetensors.h"
#include "avatar/detail.h"
#include "model/field.h"

static sherf_avatar *avatar_new(context *c) {
    sherf_avatar *a = mem_zero(c, 1, sizeof *a);
    if (a) pthread_mutex_init(&a->empty.lock, NULL);
    if (a) pthread_mutex_init(&a->detail.lock, NULL);
    return a;
}

void sherf_avatar_free(sherf_avatar *a) {
    if (!a) return;
    pthread_mutex_destroy(&a->empty.lock);
    empty_cells_free(&a->empty.cells);
    pthread_mutex_destroy(&a->detail.lock);
    detail_free(&a->detail.kept);
    if (a->field_kind) a->field_kind->release(a->field);
    mem_free(a->picture);
    mem_free(a->image);
    posed_body_free(a->observed);
    parameters_free(a->weights);
    kept_free(&a->kept);
    mem_free(a);
}

/* The weights of a model that its queries read. */
static sherf_status queried_parameters(context *c, const model *m, parameters **out) {
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

/* What the canonical body decides, and the field for this context. */
static sherf_status avatar_finish(context *c, const body_model *body, sherf_avatar *a) {
    a->body_fingerprint = body->fingerprint;
    if (!a->observed) {
        sherf_status status = posed_body_create(c, body, a->pose.poses_rad, a->pose.shapes, a->pose.R,
                                                a->pose.Th_m, &a->observed);
        if (status != SHERF_OK) return status;
    }
    a->observed->blend_m = (float)a->config.skin_blend_mm / 1000;
    a->field_kind = a->config.kind->field ? a->config.kind->field : &field_of_ops;
    return a->field_kind->create(c, a, body, &a->field);
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
    if (status == SHERF_OK) status = queried_parameters(c, m, &a->weights);
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

/* ---- the file ---- */
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
    const size_t most = OWN_ITEMS + (size_t)a->kept.count + (size_t)a->weights->count;
    float numbers[NUMBERS];
    char fingerprint[32], key[MODEL_KEY], *config = model_config_text(c, &a->config);
    safetensor_item *item = mem_zero(c, most, sizeof *item);
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
    a->picture = copy_of(c, t->data, bytes, 1);
    a->picture_height = (int)t->dim[0];
    a->picture_width = (int)t->dim[1];
    return a->picture ? SHERF_OK : SHERF_NO_MEMORY;
}

static sherf_status weights_load(context *c, const safetensors *s, sherf_avatar *a) {
    model *shape = NULL; /* names and shapes of this configuration */
    sherf_status status = model_create(c, &a->config, 0, &shape);
    if (status == SHERF_OK) status = queried_parameters(c, shape, &a->weights);
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

/* ---- frames ---- */
sherf_status avatar_query(context *c, const sherf_avatar *a, const body_model *body, const point_set *points,
                          float *rgb, float *sigma) {
    return a->field_kind->run(c, a->field, body, points, rgb, sigma);
}

sherf_status avatar_composite(context *c, const sherf_avatar *a, const body_model *body,
                              const ray_bundle *rays, const point_set *points, const float background[3],
                              bool early_stop, sherf_frame *frame) {
    return a->field_kind->render(c, a->field, body, rays, points, background, early_stop, frame);
}

bool avatar_takes_joints(const sherf_avatar *a) {
    return a->field_kind->takes_joints && a->field_kind->takes_joints(a->field);
}

sherf_status avatar_pose(context *c, const sherf_avatar *a, const body_model *body, const sherf_pose *pose,
                         posed_body **out) {
    *out = NULL;
    if (body->fingerprint != a->body_fingerprint)
        return failure(c, SHERF_MISMATCH, "the avatar was made with another body");
    const bool joints = avatar_takes_joints(a);
    sherf_status status =
        joints ? posed_joints_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, out)
               : posed_body_create(c, body, pose->poses_rad, pose->shapes, pose->R, pose->Th_m, out);
    if (status == SHERF_OK) (*out)->blend_m = (float)a->config.skin_blend_mm / 1000;
    if (status == SHERF_OK && !joints) status = points_prepare(c, body, *out);
    if (status == SHERF_OK) return SHERF_OK;
    posed_body_free(*out);
    *out = NULL;
    return status;
}

/* NULL: the frame takes every point. */
static sherf_status empty_of(context *c, const sherf_avatar *a, const body_model *body, bool exact,
                             const empty_cells **out) {
    sherf_avatar *own = (sherf_avatar *)a; /* avatars are made by this file, on the heap */
    sherf_status status = SHERF_OK;
    *out = NULL;
    if (exact) return SHERF_OK;
    pthread_mutex_lock(&own->empty.lock);
    if (!own->empty.looked) {
        status = empty_cells_find(c, a, body, &own->empty.cells);
        own->empty.looked = status == SHERF_OK;
    }
    pthread_mutex_unlock(&own->empty.lock);
    if (a->empty.cells.bit) *out = &a->empty.cells;
    return status;
}

sherf_status avatar_detail_of(context *c, const sherf_avatar *a, const body_model *body,
                              const avatar_detail **out) {
    sherf_avatar *own = (sherf_avatar *)a;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&own->detail.lock);
    if (!own->detail.kept.texel) status = detail_create(c, a, body, &own->detail.kept);
    pthread_mutex_unlock(&own->detail.lock);
    *out = &a->detail.kept;
    return status;
}

/* A GPU's frames get theirs from the host, which poses the body again for it. */
sherf_status avatar_give_detail(context *c, const sherf_avatar *a, const body_model *body,
                                const posed_body *posed, const sherf_camera *camera,
                                const float background[3], sherf_frame *frame) {
    const avatar_detail *detail;
    const joint_pose *j = posed->joints;
    posed_body *whole = NULL;
    sherf_status status = avatar_detail_of(c, a, body, &detail);
    if (status == SHERF_OK && j) {
        status = posed_body_create(c, body, j->pose_rad, j->shape, posed->R, posed->Th, &whole);
        if (status == SHERF_OK) whole->blend_m = posed->blend_m;
        if (status == SHERF_OK) status = points_prepare(c, body, whole);
    }
    if (status == SHERF_OK)
        status = detail_apply(c, a, detail, body, j ? whole : posed, camera, background, frame);
    posed_body_free(whole);
    return status;
}

/* Density is per metre, so that opacity does not depend on the length of steps; what lies between two depths
 * does. The model learned with 8 to 15 mm a step where people stand upright. */
enum { SAMPLES_MOST = 1024 };
static const float step_most_m = 0.012f;

static float depth_most(const ray_bundle *r) {
    float most = -INFINITY;
    for (size_t i = 0; i < (size_t)r->width * (size_t)r->height; i++) most = fmaxf(most, r->far[i]);
    return most;
}

/* The rays of a frame and how many depths they have; *farthest: the last depth of all in the box. */
static sherf_status frame_rays(context *c, const sherf_avatar *a, const body_model *body,
                               const posed_body *posed, const sherf_camera *camera, int wish,
                               ray_bundle **rays, int *samples, float *farthest) {
    float min[3], max[3];
    body_world_box(body, posed, min, max);
    sherf_status status = rays_create(c, camera, min, max, rays);
    if (status != SHERF_OK) return status;
    if (wish != SHERF_SAMPLES_MODEL) rays_mend(*rays, min, max);
    *farthest = depth_most(*rays);
    *samples = wish > 0 ? wish : a->config.samples;
    if (!wish || wish == SHERF_SAMPLES_AUTO)
        *samples = rays_even_steps(*rays, *samples, SAMPLES_MOST, step_most_m);
    return SHERF_OK;
}

static sherf_status frame_gpu(context *c, const sherf_avatar *a, const posed_body *posed,
                              const sherf_camera *camera, const sherf_render_options *o,
                              const empty_cells *empty, sherf_frame *frame) {
    const bool even = !o->samples || o->samples == SHERF_SAMPLES_AUTO;
    gpu_frame_options on_gpu = {.samples = o->samples > 0 ? o->samples : a->config.samples,
                                .samples_most = even ? SAMPLES_MOST : 0,
                                .step_most_m = step_most_m,
                                .mend = o->samples != SHERF_SAMPLES_MODEL,
                                .early_stop = !o->exact,
                                .empty = empty};
    memcpy(on_gpu.background, o->background, sizeof on_gpu.background);
    if (!posed->joints)
        return failure(c, SHERF_MISMATCH, "the avatar is on a GPU, and the pose was made for the processor");
    return a->field_kind->render_joints(c, a->field, posed, camera, &on_gpu, frame);
}

sherf_status avatar_render(context *c, const sherf_avatar *a, const body_model *body, const posed_body *posed,
                           const sherf_camera *camera, const sherf_render_options *options,
                           sherf_frame *frame) {
    static const sherf_render_options plain = {{0, 0, 0}, 0, 0, 0};
    const sherf_render_options *o = options ? options : &plain;
    if (o->samples < SHERF_SAMPLES_MODEL || o->samples > SAMPLES_MOST)
        return failure(c, SHERF_BAD_ARGUMENT, "samples %d: must be 1 to %d, or 0 for automatic", o->samples,
                       SAMPLES_MOST);
    const empty_cells *empty;
    sherf_status status = camera_check(c, camera);
    const bool detail = o->detail != SHERF_DETAIL_OFF;
    if (status == SHERF_OK) status = empty_of(c, a, body, o->exact, &empty);
    ray_bundle *rays = NULL;
    point_set *points = NULL;
    float farthest;
    int samples;
    if (status == SHERF_OK && avatar_takes_joints(a)) {
        status = frame_gpu(c, a, posed, camera, o, empty, frame);
        if (status == SHERF_OK && detail)
            status = avatar_give_detail(c, a, body, posed, camera, o->background, frame);
        return status;
    }
    if (status == SHERF_OK)
        status = frame_rays(c, a, body, posed, camera, o->samples, &rays, &samples, &farthest);
    if (status != SHERF_OK) return status;
    status = points_create(c, body, posed, rays, samples, a->observed, &a->camera, empty, false, &points);
    if (status == SHERF_OK)
        status = avatar_composite(c, a, body, rays, points, o->background, !o->exact, frame);
    if (status == SHERF_OK) {
        frame->points = points->count;
        for (size_t i = 0; i < (size_t)rays->width * (size_t)rays->height; i++)
            frame->depth.data[i] = fminf(frame->depth.data[i], farthest);
    }
    rays_free(rays);
    points_free(points);
    if (status == SHERF_OK && detail)
        status = avatar_give_detail(c, a, body, posed, camera, o->background, frame);
    return status;
}

sherf_status sherf_render(sherf_context *c, const sherf_avatar *a, const sherf_body *body,
                          const sherf_pose *pose, const sherf_camera *camera,
                          const sherf_render_options *options, sherf_frame *frame) {
    posed_body *posed = NULL;
    sherf_status status = avatar_pose(c, a, body, pose, &posed);
    if (status == SHERF_OK) status = avatar_render(c, a, body, posed, camera, options, frame);
    posed_body_free(posed);
    return status;
}

void sherf_frame_free(sherf_frame *frame) {
    sherf_image_free(&frame->color);
    sherf_image_free(&frame->opacity);
    sherf_image_free(&frame->depth);
    frame->points = 0;
}

/* Colour over black is colour times opacity. */
sherf_status sherf_frame_rgba(sherf_context *c, const sherf_frame *frame, sherf_image *out) {
    const sherf_image *color = &frame->color;
    size_t pixels = (size_t)color->width * (size_t)color->height;
    if (!out->data || out->width != color->width || out->height != color->height || out->channels != 4) {
        sherf_image_free(out);
        float *data = mem_alloc(c, pixels, 4 * sizeof *data);
        if (!data) return SHERF_NO_MEMORY;
        *out = (sherf_image){color->width, color->height, 4, data};
    }
    for (size_t i = 0; i < pixels; i++) {
        float a = fminf(fmaxf(frame->opacity.data[i], 0), 1);
        for (size_t k = 0; k < 3; k++)
            out->data[4 * i + k] = a > 1e-4f ? fminf(color->data[3 * i + k] / a, 1) : 0;
        out->data[4 * i + 3] = a;
    }
    return SHERF_OK;
}
