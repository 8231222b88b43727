/* Training: the radiance field as one step of the tape. The linear layers in front of the fusion are
 * applied to planes, map and volume by ops, so that the tape takes their gradients; the rest runs in tiles,
 * forwards and backwards: on the processor (model/sherf/fused/train.h) or on a GPU (model/sherf/fused/gpu.h).
 */
#include "model/sherf/sherf.h"
#include "model/sherf/fused/gpu.h"

/* Made once for an encoded observation and used for all its frames. */
struct fused_bank {
    radiance_field *network; /* on the processor, */
    const gpu_point_training *gpu;
    gpu_points *there; /* or on a GPU */
    radiance_weights weights;
    const model *m;
    tensor *plane[3], *map, *level[POINT_LEVELS]; /* merged */
};
typedef struct fused_bank fused_bank;

/* One frame's points and their results. */
typedef struct {
    const fused_bank *bank;
    const point_set *points;
    gpu_point_set there; /* the same in the GPU's memory */
    tensor *sigma, *rgb;
} fused_node;

/* The GPU's training functions if the tape's backend works in that GPU's memory, else NULL. */
static const gpu_point_training *gpu_of(tape *t) {
    const gpu_renderer *r = gpu_renderer_of(tape_context(t));
    const tensor_memory *memory = tape_backend(t)->memory;
    return r && memory && r->memory == memory ? r->training : NULL;
}

static bool possible(tape *t, const model *m) {
    radiance_sizes sizes;
    model_sherf_sizes(&m->config, &sizes);
    if (!tape_records(t) || !model_sherf_is_fused(&m->config)) return false;
    const bool bf16 = tape_settings(t).bf16;
    const gpu_point_training *gpu = gpu_of(t);
    return gpu ? bf16 && gpu->possible(&sizes)
               : tape_backend(t) == &backend_cpu && radiance_training_possible(&sizes, bf16);
}

static void network_release(void *network) {
    radiance_field_free(network);
}

/* y [rows, width] = x [rows, width] w^T, x as rows of w's width whatever its shape. */
static tensor *through(tape *t, tensor *x, tensor *w) {
    if (!x || !w) return NULL;
    const int64_t width = tensor_columns(w);
    tensor *y =
        op_linear(t, tape_reshape(t, x, 2, (int64_t[]){tensor_count(x) / width, width}), w, NULL, 1, 1);
    return tape_reshape(t, y, x->rank, x->dim);
}

static sherf_status merge(tape *t, const model *m, const model_bank *bank, fused_bank *n) {
    const sherf_settings *k = model_sherf_settings(&m->config);
    const fusion_stage *s = &model_sherf_network(m)->fusion;
    const int64_t D = k->token_width;
    tensor *token = s->token_projection.w, *volume = s->point_projection.w;
    tensor *part[3];
    for (int i = 0; i < 3; i++) part[i] = op_slice(t, token, i * D, D); /* of planes, pixel and volume */
    for (int i = 0; i < 3; i++) n->plane[i] = through(t, bank->tensor[BANK_PLANE + i], part[0]);
    n->map = through(t, bank->tensor[BANK_FEATURES], part[1]);
    for (int l = 0, column = 0; l < POINT_LEVELS; column += k->volume_channels[l++]) {
        tensor *w = op_slice(t, volume, column, k->volume_channels[l]);
        n->level[l] = through(t, op_linear(t, bank->tensor[BANK_LEVEL + l], w, NULL, 1, 1), part[2]);
    }
    return tape_status(t);
}

static void bank_of(const model *m, const body_model *body, const observation_geometry *observation,
                    const fused_bank *n, radiance_merged *merged, radiance_bank *b) {
    const sherf_settings *k = model_sherf_settings(&m->config);
    const sherf_geometry *g = model_sherf_geometry(observation);
    *b = (radiance_bank){.merged = merged,
                         .plane_size = k->plane_resolution,
                         .feature_width = (int)n->map->dim[1],
                         .feature_height = (int)n->map->dim[0],
                         .image_width = observation->width,
                         .image_height = observation->height,
                         .image = observation->image,
                         .voxel_size_m = k->voxel_size_m};
    float max[3];
    body_canonical_bounds_z(body, b->plane_min, b->plane_max);
    body_canonical_bounds(body, b->volume_min, max);
    for (int i = 0; i < 3; i++) {
        merged->plane[i] = tensor_f32(n->plane[i]);
        b->volume_size[i] = g->volume_size[i];
    }
    merged->map = tensor_f32(n->map);
    for (int l = 0; l < POINT_LEVELS; l++) {
        merged->level[l] = tensor_f32(n->level[l]);
        b->level[l].voxels = g->level[l + 1].voxels;
        b->level[l].grid = g->level[l + 1].grid;
        for (int i = 0; i < 3; i++) b->level[l].size[i] = g->level[l + 1].size[i];
    }
}

/* Copies the bank's image and grids from the host to the GPU. */
static sherf_status place_bank(tape *t, const model_bank *bank, radiance_bank *b) {
    const tensor *image = bank->tensor[BANK_IMAGE];
    b->image = image ? tensor_f32(image) : NULL;
    for (int l = 0; l < POINT_LEVELS; l++) {
        const int64_t cells[3] = {b->level[l].size[0], b->level[l].size[1], b->level[l].size[2]};
        const tensor *grid = tape_constant(t, T_I32, 3, cells, b->level[l].grid);
        if (!grid || !b->image) return tape_status(t);
        b->level[l].grid = tensor_i32(grid);
    }
    return SHERF_OK;
}

static sherf_status place_points(tape *t, const point_set *p, gpu_point_set *out) {
    const int64_t three[2] = {p->count, 3}, two[2] = {p->count, 2};
    const tensor *canonical = tape_input(t, p->canonical, 2, three),
                 *direction = tape_input(t, p->direction_canonical, 2, three),
                 *px = tape_input(t, p->observed_px, 2, two);
    if (!canonical || !direction || !px) return tape_status(t);
    *out = (gpu_point_set){p->count, tensor_f32(canonical), tensor_f32(direction), tensor_f32(px)};
    return SHERF_OK;
}

static sherf_status processor_backward(tape *t, const fused_node *n, const tensor *drgb, const tensor *dsigma,
                                       const radiance_gradients *out) {
    tape *work = tape_nested(t, false);
    if (!work) return tape_status(t);
    tape_reset(work);
    sherf_status status =
        radiance_field_backward(work, n->bank->network, &n->bank->weights, n->points, tensor_f32(n->rgb),
                                tensor_f32(drgb), tensor_f32(dsigma), out);
    tape_reset(work);
    return status;
}

static sherf_status fused_backward(tape *t, void *payload) {
    const fused_node *n = payload;
    const fused_bank *f = n->bank;
    if (!n->sigma->grad && !n->rgb->grad) return SHERF_OK;
    tensor *dsigma = tape_grad(t, n->sigma), *drgb = tape_grad(t, n->rgb), *map = tape_grad(t, f->map);
    radiance_gradients out = {.values = f->m->weights->values, .grads = f->m->weights->grads};
    bool good = dsigma && drgb && map && out.grads;
    for (int i = 0; i < 3 && good; i++) {
        tensor *plane = tape_grad(t, f->plane[i]), *level = tape_grad(t, f->level[i]);
        good = plane && level;
        if (!good) break;
        out.plane[i] = tensor_f32(plane);
        out.level[i] = tensor_f32(level);
    }
    if (!good) return tape_status(t);
    out.map = tensor_f32(map);
    return f->gpu ? f->gpu->backward(t, f->there, &n->there, tensor_f32(n->rgb), tensor_f32(drgb),
                                     tensor_f32(dsigma), &out)
                  : processor_backward(t, n, drgb, dsigma, &out);
}

static sherf_status fused_create(tape *t, const model *m, const body_model *body,
                                 const observation_geometry *g, const model_bank *bank, fused_bank **out) {
    radiance_sizes sizes;
    radiance_merged merged;
    radiance_bank b;
    fused_bank *f = tape_alloc(t, 1, sizeof *f);
    if (!f) return tape_status(t);
    *f = (fused_bank){.m = m, .gpu = gpu_of(t)};
    sherf_status status = merge(t, m, bank, f);
    if (status != SHERF_OK) return status;
    model_sherf_sizes(&m->config, &sizes);
    model_sherf_weights(m->weights, &m->config, &f->weights);
    bank_of(m, body, g, f, &merged, &b);
    *out = f;
    if (f->gpu) {
        status = place_bank(t, bank, &b);
        return status == SHERF_OK ? f->gpu->create(t, &sizes, &f->weights, &b, &f->there) : status;
    }
    status =
        radiance_field_create(tape_context(t), &sizes, &f->weights, &b, tape_settings(t).bf16, &f->network);
    if (status == SHERF_OK && !tape_own(t, f->network, network_release)) status = tape_status(t);
    return status;
}

static sherf_status run(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                        model_bank *bank, const point_set *points, tensor *sigma, tensor *rgb) {
    sherf_bank *own = bank->own;
    sherf_status status = SHERF_OK;
    if (!own->fused) status = fused_create(t, m, body, g, bank, &own->fused);
    fused_node *n = tape_alloc(t, 1, sizeof *n);
    if (status != SHERF_OK || !n) return status != SHERF_OK ? status : tape_status(t);
    const fused_bank *f = own->fused;
    *n = (fused_node){.bank = f, .points = points, .sigma = sigma, .rgb = rgb};
    if (f->gpu) {
        status = place_points(t, points, &n->there);
        if (status == SHERF_OK)
            status = f->gpu->run(t, f->there, &n->there, tensor_f32(rgb), tensor_f32(sigma));
    } else {
        status = radiance_field_run(tape_context(t), f->network, points, tensor_f32(rgb), tensor_f32(sigma));
    }
    if (status == SHERF_OK) tape_record(t, fused_backward, n);
    return status == SHERF_OK ? tape_status(t) : status;
}

const model_fused_training model_sherf_fused_training = {possible, run};
