/* The field of a model that has no fused one: its query on a tape, all points of a frame before they are
 * composited. */
#include "model/field.h"

#include <string.h>

#include "sampling/tiles.h"

typedef struct {
    model *m;
    observation_geometry *g;
    const kept_bank *kept;
} ops_field;

static void release(void *field) {
    ops_field *f = field;
    if (!f) return;
    observation_geometry_free(f->g);
    model_free(f->m);
    mem_free(f);
}

/* A whole model with the weights that were kept. */
static sherf_status take_weights(context *c, const field_source *from, model **out) {
    sherf_status status = model_create(c, from->config, 0, out);
    for (int i = 0; status == SHERF_OK && i < from->weights->count; i++) {
        const parameter *kept = from->weights->item[i], *to = parameter_find((*out)->weights, kept->name);
        memcpy(to->value.data, kept->value.data, (size_t)tensor_count(&to->value) * sizeof(float));
    }
    return status == SHERF_OK ? model_place(c, *out) : status;
}

static sherf_status create(context *c, const field_source *from, const body_model *body, void **out) {
    ops_field *f = mem_zero(c, 1, sizeof *f);
    *out = NULL;
    if (!f) return SHERF_NO_MEMORY;
    f->kept = from->kept;
    sherf_status status = take_weights(c, from, &f->m);
    if (status == SHERF_OK)
        status = observation_geometry_create(c, from->config, body, &from->image, from->camera, from->pose,
                                             false, &f->g);
    if (status == SHERF_OK)
        *out = f;
    else
        release(f);
    return status;
}

static sherf_status query(tape *t, const ops_field *f, const body_model *body, const point_set *points,
                          float *rgb, float *sigma) {
    const dtype real = tape_backend(t)->real;
    model_bank bank = {.count = f->kept->count};
    for (int i = 0; i < bank.count; i++) {
        const kept_array *k = &f->kept->array[i];
        bank.tensor[i] = tape_constant(t, k->type, k->rank, k->dim, k->data);
    }
    tensor *density = tape_tensor(t, real, 2, (int64_t[]){points->count, 1}),
           *color = tape_tensor(t, real, 2, (int64_t[]){points->count, 3});
    if (tape_status(t) != SHERF_OK) return tape_status(t);
    sherf_status status = model_query(t, f->m, body, f->g, &bank, points, density, color);
    if (status == SHERF_OK) status = tensor_download(tape_context(t), density, sigma);
    return status == SHERF_OK ? tensor_download(tape_context(t), color, rgb) : status;
}

/* The tape is the call's own: fields are for any thread. */
static sherf_status run(context *c, void *field, const body_model *body, const point_set *points, float *rgb,
                        float *sigma) {
    if (!points->count) return SHERF_OK;
    tape *t = tape_create(
        c, (tape_options){.backend = backend_of(c), .bf16 = c->precision == SHERF_PRECISION_BF16});
    sherf_status status = t ? query(t, field, body, points, rgb, sigma) : SHERF_NO_MEMORY;
    tape_free(t);
    return status;
}

static sherf_status render(context *c, void *field, const body_model *body, const ray_bundle *rays,
                           const point_set *points, const float background[3], bool early_stop,
                           sherf_frame *frame) {
    const size_t n = (size_t)points->count + 1;
    float *rgb = mem_alloc(c, n, 3 * sizeof *rgb), *sigma = mem_alloc(c, n, sizeof *sigma);
    sherf_status status = rgb && sigma ? run(c, field, body, points, rgb, sigma) : SHERF_NO_MEMORY;
    if (status == SHERF_OK) status = points_render(c, rays, points, rgb, sigma, background, frame);
    mem_free(rgb);
    mem_free(sigma);
    return status;
}

const field_kind field_of_ops = {.create = create, .release = release, .run = run, .render = render};
