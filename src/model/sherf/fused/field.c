/* The field of SHERF's avatars: the fused network, packed for the processor or placed on the GPU of the
 * context that the avatar was made or loaded in. */
#include "model/field.h"

#include <pthread.h>
#include <string.h>

#include "model/sherf/fused/gpu.h"
#include "model/sherf/sherf.h"

typedef struct {
    field_source from;
    radiance_bank canonical; /* the bank's members that the canonical body determines */
    radiance_field *network; /* NULL on a GPU, unless the processor is queried too */
    gpu_avatar *gpu;         /* or NULL */
    const gpu_renderer *renderer;
    pthread_mutex_t lock; /* guards making `network`, and the GPU's room for frames */
} fused_field;

static void release(void *field) {
    fused_field *f = field;
    if (!f) return;
    if (f->gpu) f->renderer->release(f->gpu);
    radiance_field_free(f->network);
    pthread_mutex_destroy(&f->lock);
    mem_free(f);
}

/* ---- the bank, from the arrays that the avatar keeps ---- */
/* *out: the grid; the caller frees it, even after an error. */
static sherf_status level_of(context *c, const kept_array *value, const kept_array *voxel, int l,
                             radiance_bank *b, int32_t **out) {
    int64_t cells = 1;
    for (int i = 0; i < 3; i++) cells *= b->level[l].size[i] = b->volume_size[i] >> (l + 1);
    if (voxel->dim[0] != value->dim[0])
        return failure(c, SHERF_BAD_FILE, "tensor %s is missing or of the wrong shape", voxel->name);
    int32_t *grid = *out = mem_alloc(c, (size_t)cells, sizeof *grid);
    b->level[l].voxels = value->dim[0];
    b->level[l].value = value->data;
    b->level[l].grid = grid;
    if (!grid) return SHERF_NO_MEMORY;
    memset(grid, 0xff, (size_t)cells * sizeof *grid);
    const int32_t *number = voxel->data;
    for (int64_t i = 0; i < value->dim[0]; i++) {
        const int32_t at = number[i];
        if (at < 0 || at >= cells || grid[at] >= 0)
            return failure(c, SHERF_BAD_FILE, "tensor %s: voxel %lld out of place", voxel->name,
                           (long long)i);
        grid[at] = (int32_t)i;
    }
    return SHERF_OK;
}

static void grids_free(int32_t *grid[POINT_LEVELS]) {
    for (int l = 0; l < POINT_LEVELS; l++) mem_free(grid[l]);
}

/* grid: NULL on entry; receives the bank's grids, to be freed with grids_free even after an error. The source
 * keeps owning the other arrays. */
static sherf_status bank_of(context *c, const fused_field *f, radiance_bank *b, int32_t *grid[POINT_LEVELS]) {
    const field_source *from = &f->from;
    const kept_array *k = from->kept->array; /* features, planes, then values and voxels by level */
    *b = f->canonical;
    b->features = k[0].data;
    b->feature_height = (int)k[0].dim[0];
    b->feature_width = (int)k[0].dim[1];
    b->planes = k[1].data;
    b->plane_size = model_sherf_settings(from->config)->plane_resolution;
    b->image = from->sheet->image;
    b->image_width = from->sheet->width;
    b->image_height = from->sheet->height;
    sherf_status status = SHERF_OK;
    for (int l = 0; l < POINT_LEVELS && status == SHERF_OK; l++)
        status = level_of(c, &k[2 + 2 * l], &k[3 + 2 * l], l, b, &grid[l]);
    return status;
}

static sherf_status network_make(context *c, const fused_field *f, radiance_field **out) {
    radiance_sizes sizes;
    radiance_weights weights;
    radiance_bank bank;
    int32_t *grid[POINT_LEVELS] = {NULL};
    model_sherf_sizes(f->from.config, &sizes);
    model_sherf_weights(f->from.weights, f->from.config, &weights);
    sherf_status status = bank_of(c, f, &bank, grid);
    if (status == SHERF_OK)
        status = radiance_field_create(c, &sizes, &weights, &bank, c->precision == SHERF_PRECISION_BF16, out);
    grids_free(grid);
    return status;
}

static sherf_status network_place(context *c, fused_field *f, const body_model *body) {
    const field_source *from = &f->from;
    radiance_sizes sizes;
    radiance_weights weights;
    radiance_bank bank;
    int32_t *grid[POINT_LEVELS] = {NULL};
    radiance_parts parts;
    model_sherf_sizes(from->config, &sizes);
    model_sherf_weights(from->weights, from->config, &weights);
    sherf_status status = bank_of(c, f, &bank, grid);
    if (status == SHERF_OK) status = radiance_parts_create(c, &sizes, &weights, &bank, &parts);
    grids_free(grid);
    if (status != SHERF_OK) return status;
    status = f->renderer->place(c, body, from->sheet->body, &from->sheet->camera, &parts,
                                c->precision == SHERF_PRECISION_BF16, &f->gpu);
    radiance_parts_free(&parts);
    return status;
}

static sherf_status create(context *c, const field_source *from, const body_model *body, void **out) {
    float max[3];
    fused_field *f = mem_zero(c, 1, sizeof *f);
    *out = NULL;
    if (!f) return SHERF_NO_MEMORY;
    pthread_mutex_init(&f->lock, NULL);
    f->from = *from;
    f->renderer = gpu_renderer_of(c);
    body_canonical_bounds_z(body, f->canonical.plane_min, f->canonical.plane_max);
    body_canonical_bounds(body, f->canonical.volume_min, max);
    f->canonical.voxel_size_m = model_sherf_settings(from->config)->voxel_size_m;
    sherf_status status = model_sherf_volume_size(c, from->config, body, f->canonical.volume_size);
    if (status == SHERF_OK)
        status = f->renderer ? network_place(c, f, body) : network_make(c, f, &f->network);
    if (status == SHERF_OK)
        *out = f;
    else
        release(f);
    return status;
}

/* ---- points and frames ---- */
static sherf_status run(context *c, void *field, const body_model *body, const point_set *points, float *rgb,
                        float *sigma) {
    fused_field *f = field;
    if (!f->gpu) return radiance_field_run(c, f->network, points, rgb, sigma);
    pthread_mutex_lock(&f->lock);
    sherf_status status = f->renderer->run(c, f->gpu, points, rgb, sigma);
    pthread_mutex_unlock(&f->lock);
    return status;
}

/* The processor's network; made now if so far only a GPU has it. */
static sherf_status render(context *c, void *field, const body_model *body, const ray_bundle *rays,
                           const point_set *points, const float background[3], bool early_stop,
                           sherf_frame *frame) {
    fused_field *f = field;
    sherf_status status = SHERF_OK;
    pthread_mutex_lock(&f->lock);
    if (!f->network) status = network_make(c, f, &f->network);
    pthread_mutex_unlock(&f->lock);
    if (status != SHERF_OK) return status;
    return radiance_field_render(c, f->network, rays, points, background, early_stop, frame);
}

static bool takes_joints(const void *field) {
    const fused_field *f = field;
    return f->gpu != NULL;
}

static size_t device_bytes(const void *field) {
    const fused_field *f = field;
    return f->gpu ? f->renderer->bytes(f->gpu) : 0;
}

static sherf_status render_joints(context *c, void *field, const posed_body *posed,
                                  const sherf_camera *camera, const gpu_frame_options *options,
                                  sherf_frame *frame) {
    fused_field *f = field;
    pthread_mutex_lock(&f->lock);
    sherf_status status = f->renderer->render(c, f->gpu, posed, camera, options, frame);
    pthread_mutex_unlock(&f->lock);
    return status;
}

const field_kind model_sherf_field = {create,       release,      run,          render,
                                      takes_joints, device_bytes, render_joints};
