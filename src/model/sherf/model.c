/* SHERF as an entry of the table of models. model_sherf_encode extracts the hierarchical features of an
 * observation (section 3.3); model_sherf_points reads them at points, fuses and decodes them (3.4). */
#include "model/field.h"
#include "model/sherf/sherf.h"

static void network_declare(declaration *d, const model_config *config, void *network) {
    sherf_network *n = network;
    const sherf_settings *k = model_sherf_settings(config);
    if (k->use_global) global_declare(d, k, &n->global);
    if (k->use_point) point_declare(d, k, &n->point);
    if (k->use_point || k->use_pixel)
        pixel_declare(d, k, &n->pixel); /* vertices read the pixel features too */
    fusion_declare(d, k, &n->fusion);
    decoder_declare(d, k, &n->decoder);
}

/* ---- forwards ---- */
static void encode_global(tape *t, tape *work, const sherf_network *n, tensor *image, int64_t D,
                          model_bank *bank, model_stages *stages) {
    sherf_bank *own = bank->own;
    own->latent = tape_keep(t, work, global_latent(work, &n->global, image));
    own->style = global_style(t, &n->global, own->latent);
    tensor *planes = tape_keep(t, work, global_planes(work, &n->global, own->style, stages));
    for (int k = 0; k < 3; k++) bank->tensor[BANK_PLANE + k] = op_slice(t, planes, k * D, D);
}

/* A stand-in for tensors that no query reads, as small as possible. */
static void fill_absent(tape *t, const sherf_settings *k, model_bank *bank) {
    for (int i = 0; i < 3 && !k->use_global; i++)
        bank->tensor[BANK_PLANE + i] = tape_zeros(t, T_F32, 3, (int64_t[]){1, 1, k->token_width});
    if (!k->use_point && !k->use_pixel)
        bank->tensor[BANK_FEATURES] = tape_zeros(t, T_F32, 3, (int64_t[]){1, 1, k->feature_width});
    for (int l = 0; l < k->point_levels && !k->use_point; l++)
        bank->tensor[BANK_LEVEL + l] = tape_zeros(t, T_F32, 2, (int64_t[]){1, k->volume_channels[l]});
}

sherf_status model_sherf_encode(tape *t, const model *m, const body_model *body,
                                const observation_geometry *g, model_bank *bank, model_stages *stages) {
    const sherf_network *n = model_sherf_network(m);
    const sherf_settings *k = model_sherf_settings(&m->config);
    sherf_bank *own = tape_alloc(t, 1, sizeof *own);
    *bank = (model_bank){.count = BANK_LEVEL + k->point_levels, .own = own};
    if (!own) return tape_status(t);
    *own = (sherf_bank){0};
    tape *work = stages ? t : tape_for_parts(t);
    if (!work) return tape_status(t);
    tensor *image = tape_input(t, g->image, 3, (int64_t[]){g->height, g->width, 3});
    bank->tensor[BANK_IMAGE] = image;
    fill_absent(t, k, bank);
    if (k->use_point || k->use_pixel)
        bank->tensor[BANK_FEATURES] = tape_keep(t, work, pixel_features(work, &n->pixel, image));
    if (k->use_global) encode_global(t, work, n, image, k->token_width, bank, stages);
    return k->use_point ? point_encode(t, &n->point, &n->pixel, g, bank) : tape_status(t);
}

static sherf_status encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank) {
    return model_sherf_encode(t, m, body, g, bank, NULL);
}

sherf_status model_sherf_points(tape *t, const model *m, const body_model *body,
                                const observation_geometry *g, const model_bank *bank,
                                const point_set *points, int64_t begin, int64_t end, point_outputs *out) {
    const sherf_network *s = model_sherf_network(m);
    const sherf_settings *k = model_sherf_settings(&m->config);
    const int64_t n = end - begin;
    const float *canonical = points->canonical + 3 * begin;
    tensor *plane[3] = {NULL}, *pixel = NULL;
    *out = (point_outputs){0};
    if (k->use_global) global_sample(t, body, bank, canonical, n, plane);
    if (k->use_pixel) pixel = pixel_sample(t, &s->pixel, bank, points->observed_px + 2 * begin, n);
    if (k->use_point) out->volume = point_sample(t, g, bank, canonical, n);
    out->fusion = fusion_forward(t, &s->fusion, plane, pixel, out->volume);
    for (int i = 0; i < 3; i++) out->plane[i] = plane[i];
    decoder_forward(t, &s->decoder, out->fusion, canonical, points->direction_canonical + 3 * begin, n,
                    &out->sigma, &out->rgb);
    return tape_status(t);
}

static sherf_status query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb) {
    point_outputs out;
    sherf_status status = model_sherf_points(t, m, body, g, bank, points, begin, end, &out);
    *sigma = out.sigma;
    *rgb = out.rgb;
    return status;
}

/* ---- arrays that avatars keep ---- */
/* For the fused network: planes in one piece, and voxels by number. Otherwise the bank's tensors. */
static void bank_kept(const model_config *config, kept_bank *out) {
    static const char *const plane[] = {"planes.0", "planes.1", "planes.2"};
    static const char *const value[] = {"volume.1.value", "volume.2.value", "volume.3.value",
                                        "volume.4.value"};
    const sherf_settings *k = model_sherf_settings(config);
    const int64_t R = k->use_global ? k->plane_resolution : 1;
    *out = (kept_bank){.count = BANK_LEVEL + k->point_levels};
    for (int i = 0; i < 3; i++)
        out->array[BANK_PLANE + i] = (kept_array){plane[i], T_F32, 3, {R, R, k->token_width}};
    out->array[BANK_FEATURES] = (kept_array){"features", T_F32, 3, {0, 0, k->feature_width}};
    out->array[BANK_IMAGE] = (kept_array){"bank.image", T_F32, 3, {0, 0, 3}};
    for (int l = 0; l < k->point_levels; l++)
        out->array[BANK_LEVEL + l] = (kept_array){value[l], T_F32, 2, {0, k->volume_channels[l]}};
}

static sherf_status bank_keep(context *c, const model_bank *bank, kept_bank *out) {
    sherf_status status = SHERF_OK;
    for (int i = 0; i < out->count && status == SHERF_OK; i++)
        status = kept_take(c, bank->tensor[i], &out->array[i]);
    return status;
}

static void kept(const model_config *config, kept_bank *out) {
    static const char *const value[] = {"volume.1.value", "volume.2.value", "volume.3.value"};
    static const char *const voxel[] = {"volume.1.voxel", "volume.2.voxel", "volume.3.voxel"};
    const sherf_settings *k = model_sherf_settings(config);
    const int64_t R = k->plane_resolution;
    if (!model_sherf_is_fused(config)) {
        bank_kept(config, out);
        return;
    }
    *out = (kept_bank){0};
    out->array[out->count++] = (kept_array){"features", T_F32, 3, {0, 0, k->feature_width}};
    out->array[out->count++] = (kept_array){"planes", T_F32, 4, {3, R, R, k->token_width}};
    for (int l = 0; l < POINT_LEVELS; l++) {
        out->array[out->count++] = (kept_array){value[l], T_F32, 2, {0, k->volume_channels[l]}};
        out->array[out->count++] = (kept_array){voxel[l], T_I32, 1, {0}};
    }
}

/* Linear voxel numbers of a level's rows: the inverse of the grid. */
static int32_t *voxel_numbers(context *c, const sherf_geometry *g, int l) {
    int32_t *number = mem_zero(c, (size_t)g->level[l].voxels, sizeof *number);
    const int64_t cells = (int64_t)g->level[l].size[0] * g->level[l].size[1] * g->level[l].size[2];
    for (int64_t i = 0; number && i < cells; i++)
        if (g->level[l].grid[i] >= 0) number[g->level[l].grid[i]] = (int32_t)i;
    return number;
}

static sherf_status keep(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                         kept_bank *out) {
    const sherf_geometry *own = model_sherf_geometry(g);
    if (!model_sherf_is_fused(&m->config)) return bank_keep(c, bank, out);
    kept_array *features = &out->array[0], *planes = &out->array[1];
    sherf_status status = kept_take(c, bank->tensor[BANK_FEATURES], features);
    const size_t each = (size_t)(planes->dim[1] * planes->dim[2] * planes->dim[3]);
    float *values = mem_alloc(c, 3 * each, sizeof *values);
    planes->data = values;
    if (!values) status = SHERF_NO_MEMORY;
    for (int k = 0; k < 3 && status == SHERF_OK; k++)
        status = tensor_download(c, bank->tensor[BANK_PLANE + k], values + (size_t)k * each);
    for (int l = 0; l < POINT_LEVELS && status == SHERF_OK; l++) {
        kept_array *value = &out->array[2 + 2 * l], *voxel = value + 1;
        status = kept_take(c, bank->tensor[BANK_LEVEL + l], value);
        voxel->dim[0] = own->level[l + 1].voxels;
        voxel->data = voxel_numbers(c, own, l + 1);
        if (!voxel->data) status = SHERF_NO_MEMORY;
    }
    return status;
}

static const field_kind *field(const model_config *config) {
    return model_sherf_is_fused(config) ? &model_sherf_field : NULL;
}

const model_kind model_sherf = {
    .name = "sherf",
    .presets = model_sherf_presets,
    .settings = model_sherf_setting_list,
    .defaults = model_sherf_defaults,
    .check = model_sherf_check,
    .infer = model_sherf_infer,
    .network_bytes = sizeof(sherf_network),
    .declare = network_declare,
    .reads_observed_px = true,
    .queried = (const char *const[]){"decoder.", "renderer.conv1d_", "renderer.transformer.",
                                     "renderer.fair.", "renderer.adain.", "renderer.siren.", NULL},
    .resnets = (const char *const[]){"encoder_2d.backbone.", "encoder_2d_feature.backbone.", NULL},
    .observe = model_sherf_observe,
    .observed_free = model_sherf_geometry_free,
    .encode = encode,
    .query = query,
    .fused_training = &model_sherf_fused_training,
    .kept = kept,
    .keep = keep,
    .field = field,
    .point_products = model_sherf_point_products};
