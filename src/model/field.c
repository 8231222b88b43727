/* The field of a model without a fused one: it queries all points of a frame on a tape, then composites
 * them. */
#include "model/field.h"

#include <math.h>
#include <string.h>

#include "sampling/tiles.h"

typedef struct {
    model *m;
    observation_geometry *g;
    const kept_bank *kept;
    kept_bank restored; /* the arrays after the model's `restore`, where it has one */
} ops_field;

static void release(void *field) {
    ops_field *f = field;
    if (!f) return;
    observation_geometry_free(f->g);
    model_free(f->m);
    kept_free(&f->restored);
    mem_free(f);
}

/* A whole model with the kept weights. */
static sherf_status take_weights(context *c, const field_source *from, model **out) {
    sherf_status status = model_create(c, from->config, 0, out);
    for (int i = 0; status == SHERF_OK && i < from->weights->count; i++) {
        const parameter *kept = from->weights->item[i], *to = parameter_find((*out)->weights, kept->name);
        memcpy(to->value.data, kept->value.data, (size_t)tensor_count(&to->value) * sizeof(float));
    }
    return status == SHERF_OK ? model_place(c, *out) : status;
}

static tape *tape_of(context *c) {
    return tape_create(
        c, (tape_options){.backend = backend_of(c), .bf16 = c->precision == SHERF_PRECISION_BF16});
}

static model_bank bank_of(tape *t, const kept_bank *kept) {
    model_bank bank = {.count = kept->count};
    for (int i = 0; i < bank.count; i++) {
        const kept_array *k = &kept->array[i];
        bank.tensor[i] = tape_constant(t, k->type, k->rank, k->dim, k->data);
    }
    return bank;
}

static sherf_status restore(context *c, ops_field *f) {
    const model_kind *kind = f->m->config.kind;
    if (!kind->restore) return SHERF_OK;
    tape *t = tape_of(c);
    if (!t) return SHERF_NO_MEMORY;
    const model_bank kept = bank_of(t, f->kept);
    model_bank bank = {0};
    sherf_status status = tape_status(t);
    if (status == SHERF_OK) status = kind->restore(t, f->m, f->g, f->kept, &kept, &bank);
    for (int i = 0; i < bank.count && status == SHERF_OK; i++) {
        kept_array *k = &f->restored.array[f->restored.count++];
        *k = (kept_array){"", T_F32, bank.tensor[i]->rank};
        status = kept_take(c, bank.tensor[i], k);
    }
    tape_free(t);
    f->kept = &f->restored;
    return status;
}

static sherf_status create(context *c, const field_source *from, const body_model *body, void **out) {
    ops_field *f = mem_zero(c, 1, sizeof *f);
    *out = NULL;
    if (!f) return SHERF_NO_MEMORY;
    f->kept = from->kept;
    sherf_status status = take_weights(c, from, &f->m);
    if (status == SHERF_OK)
        status = observation_geometry_of(c, from->config, body, from->pictures, from->picture, false, &f->g);
    if (status == SHERF_OK) status = restore(c, f);
    if (status == SHERF_OK)
        *out = f;
    else
        release(f);
    return status;
}

static sherf_status query(tape *t, const ops_field *f, const body_model *body, const point_set *points,
                          float *rgb, float *sigma) {
    const dtype real = tape_backend(t)->real;
    const model_bank bank = bank_of(t, f->kept);
    tensor *density = tape_tensor(t, real, 2, (int64_t[]){points->count, 1}),
           *color = tape_tensor(t, real, 2, (int64_t[]){points->count, 3});
    if (tape_status(t) != SHERF_OK) return tape_status(t);
    sherf_status status = model_query(t, f->m, body, f->g, &bank, points, density, color);
    if (status == SHERF_OK) status = tensor_download(tape_context(t), density, sigma);
    return status == SHERF_OK ? tensor_download(tape_context(t), color, rgb) : status;
}

/* Each call has its own tape, since any thread may use a field. */
static sherf_status run(context *c, void *field, const body_model *body, const point_set *points, float *rgb,
                        float *sigma) {
    if (!points->count) return SHERF_OK;
    tape *t = tape_of(c);
    sherf_status status = t ? query(t, field, body, points, rgb, sigma) : SHERF_NO_MEMORY;
    tape_free(t);
    return status;
}

/* Turns [N, 5] over black into a frame over `background`. */
static void frame_fill(const float *y, const float background[3], sherf_frame *frame) {
    const size_t n = (size_t)frame->color.width * (size_t)frame->color.height;
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < 3; k++)
            frame->color.data[3 * i + k] = y[5 * i + k] + (1 - y[5 * i + 3]) * background[k];
        frame->opacity.data[i] = y[5 * i + 3];
        frame->depth.data[i] = y[5 * i + 4];
    }
}

/* A frame of a model with its own `frame`: with more than one pass, or at other depths. */
static sherf_status render_whole(context *c, const ops_field *f, const body_model *body,
                                 const ray_bundle *rays, const point_set *points, const float background[3],
                                 sherf_frame *frame) {
    ray_bundle own_rays = *rays; /* not freed: the caller's memory */
    point_set own_points = *points;
    target_geometry target = {
        .rays = &own_rays, .points = &own_points, .depth_min = INFINITY, .depth_max = -INFINITY};
    const int64_t n = points->rays;
    float *y = mem_alloc(c, (size_t)n, 5 * sizeof *y);
    tape *t = tape_of(c);
    tensor *made;
    for (int64_t i = 0; i < n; i++) {
        target.depth_min = fminf(target.depth_min, rays->near[i]);
        target.depth_max = fmaxf(target.depth_max, rays->far[i]);
    }
    sherf_status status = y && t ? SHERF_OK : SHERF_NO_MEMORY;
    if (status == SHERF_OK) {
        model_bank bank = bank_of(t, f->kept);
        status = model_frame(t, f->m, body, f->g, &bank, &target, 0, 0, &made);
    }
    if (status == SHERF_OK) status = tensor_download(c, made, y);
    if (status == SHERF_OK) status = frame_shape(c, rays->width, rays->height, frame);
    if (status == SHERF_OK) frame_fill(y, background, frame);
    frame->points = points->count;
    tape_free(t);
    mem_free(y);
    return status;
}

static sherf_status render(context *c, void *field, const body_model *body, const ray_bundle *rays,
                           const point_set *points, const float background[3], bool early_stop,
                           sherf_frame *frame) {
    const ops_field *f = field;
    const size_t n = (size_t)points->count + 1;
    if (f->m->config.kind->frame) return render_whole(c, f, body, rays, points, background, frame);
    float *rgb = mem_alloc(c, n, 3 * sizeof *rgb), *sigma = mem_alloc(c, n, sizeof *sigma);
    sherf_status status = rgb && sigma ? run(c, field, body, points, rgb, sigma) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = points_render(c, rays, points, rgb, sigma, background, frame);
    mem_free(rgb);
    mem_free(sigma);
    return status;
}

const field_kind field_of_ops = {.create = create, .release = release, .run = run, .render = render};
