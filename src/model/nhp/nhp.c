/* Neural Human Performer as an entry of the table. */
#include "model/nhp/nhp.h"

#include <math.h>
#include <string.h>

#include "model/depths.h"
#include "model/stages.h"

enum { DIRECTION_FREQUENCIES = 4, DIRECTION_WIDTH = 27, BANK_MAP = 0, BANK_LEVEL = 1 };
static const float last_way = 1e10f; /* the distance behind a ray's last sample */

/* ---- settings ---- */
#define SMALL                                                                                                \
    "width=128,volume_channels0=32,volume_channels1=32,volume_channels2=64,volume_channels3=64,"             \
    "voxel_size_m=0.01,image_size=256"
#define MATCHED "own=0,samples=48"
static const model_preset presets[] = {
    {"own", ""}, {"own-small", SMALL}, {"matched", MATCHED}, {"matched-small", SMALL "," MATCHED}, {0}};

#define AT(field) MODEL_SETTING_AT(nhp_settings, field)
static const model_setting settings[] = {{"encoder_width", AT(encoder_width), 8, 256, 8},
                                         {"width", AT(width), 8, 1024, 8},
                                         {"volume_channels0", AT(volume_channels[0]), 4, 256, 1},
                                         {"volume_channels1", AT(volume_channels[1]), 4, 256, 1},
                                         {"volume_channels2", AT(volume_channels[2]), 4, 256, 1},
                                         {"volume_channels3", AT(volume_channels[3]), 4, 256, 1},
                                         {"voxel_size_m", AT(voxel_size_m), 0.002, 0.1, 0},
                                         {"own", AT(own), 0, 1, 1},
                                         {0}};

static void defaults(model_config *out) {
    const nhp_settings own = {.encoder_width = 64,
                              .width = 256,
                              .volume_channels = {64, 64, 128, 128},
                              .voxel_size_m = 0.005f,
                              .own = 1};
    memcpy(out->own.bytes, &own, sizeof own);
    out->samples = 64;
    out->image_size = 512;
}

static bool whole_box(const model_config *config) {
    return nhp_settings_of(config)->own;
}

/* 1024 rays of one target a step, half of them from the mask; the rate is a tenth after 500,000 steps. */
static const training_recipe *recipe(const model_config *config) {
    static const training_recipe own = {.rays = 1024,
                                        .rays_inside = 0.5f,
                                        .batch = 1,
                                        .learning_rate = 5e-4,
                                        .beta1 = 0.9,
                                        .beta2 = 0.999,
                                        .halve_every = 150515};
    return nhp_settings_of(config)->own ? &own : NULL;
}

/* ---- parameters ---- */
static void network_declare(declaration *d, const model_config *config, void *network) {
    nhp_network *n = network;
    const nhp_settings *k = nhp_settings_of(config);
    const int64_t W = k->width, F = 4 * (int64_t)k->encoder_width, half = W / 2; /* F: 1 + 1 + 2 widths */
    int64_t volume = 0;
    for (int l = 0; l < NHP_LEVELS; l++) volume += k->volume_channels[l];
    resnet_declare(d, "encoder", 18, k->encoder_width, NHP_STAGES - 1, &n->encoder);
    nhp_volume_declare(d, k, &n->volume);
    n->from_volume = linear_declare(d, "field.from_volume", true, W, volume);
    n->from_pixel = linear_declare(d, "field.from_pixel", true, W, F);
    n->volume_value = linear_declare(d, "field.volume_value", false, W, W);
    n->pixel_value = linear_declare(d, "field.pixel_value", false, W, W);
    n->hidden = linear_declare(d, "field.hidden", true, W, W);
    n->geometry = linear_declare(d, "field.geometry", true, W, W);
    n->density[0] = linear_declare(d, "field.density.0", true, W, W);
    n->density[1] = linear_declare(d, "field.density.1", false, 1, W);
    n->color_geometry = linear_declare(d, "field.color_geometry", false, W, W);
    n->color_pixel = linear_declare(d, "field.color_pixel", false, W, F);
    n->view = linear_declare(d, "field.view", true, half, W + DIRECTION_WIDTH);
    n->view_pixel = linear_declare(d, "field.view_pixel", false, half, F);
    n->last = linear_declare(d, "field.last", true, half, half);
    n->color = linear_declare(d, "field.color", false, 3, half);
}

/* ---- encode ---- */
typedef struct {
    tensor *stage[NHP_STAGES];
} nhp_bank; /* model_bank.own; the bank has the map and the levels */

static sherf_status encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank) {
    const nhp_network *n = m->network;
    nhp_bank *own = tape_alloc(t, 1, sizeof *own);
    if (!own) return tape_status(t);
    bank->own = own;
    tensor *image = tape_input(t, g->image, 3, (int64_t[]){g->height, g->width, 3});
    tensor *x = own->stage[0] = resnet_stem(t, &n->encoder, image);
    x = op_max_pool(t, x, 3, 2, 1);
    for (int i = 1; i < NHP_STAGES; i++) x = own->stage[i] = resnet_stage(t, &n->encoder, i, x);
    tensor *map = stages_side_by_side(t, NHP_STAGES, own->stage);
    bank->tensor[BANK_MAP] = map;
    bank->count = BANK_LEVEL + NHP_LEVELS;
    nhp_volume_encode(t, &n->volume, g, map, bank->tensor + BANK_LEVEL);
    return tape_status(t);
}

/* ---- query ---- */
typedef struct {
    float *world, *at, *direction; /* [P, 3] in the observation's world, [P, 2] in the map, [P, 3] unit */
} point_inputs;

typedef struct {
    const body_model *body;
    const observation_geometry *g;
    const point_set *points;
    int64_t begin;
    map_place place;
    point_inputs in;
} input_job;

/* A point's place in the observation's world: the point itself, or through canonical space. */
static void observed_place(const input_job *j, int64_t i, float world[3]) {
    if (!j->points->canonical) {
        point_world(j->points, i, world);
        return;
    }
    const float *canonical = j->points->canonical + 3 * i;
    const int32_t nearest = vertex_grid_nearest_from(body_canonical_grid(j->body), canonical, -1, NULL);
    deform_from_canonical(j->body, j->g->body, 1, canonical, &nearest, world);
}

static void input_range(void *arg, int64_t begin, int64_t end, int thread) {
    const input_job *j = arg;
    for (int64_t i = begin; i < end; i++) {
        const int64_t p = j->begin + i;
        const float *d = j->points->on ? j->points->on->direction + 3 * (int64_t)j->points->ray[p]
                                       : j->points->direction_canonical + 3 * p;
        const float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        float px[2];
        observed_place(j, p, j->in.world + 3 * i);
        camera_project(&j->g->camera, 1, j->in.world + 3 * i, px, NULL);
        map_position(&j->place, px, j->in.at + 2 * i);
        for (int k = 0; k < 3; k++) j->in.direction[3 * i + k] = length > 0 ? d[k] / length : 0;
    }
}

static bool inputs(tape *t, const body_model *body, const observation_geometry *g, const tensor *map,
                   const point_set *points, int64_t begin, int64_t count, point_inputs *in) {
    float *room = tape_alloc(t, (size_t)count + 1, 8 * sizeof *room);
    if (!room) return false;
    *in = (point_inputs){room, room + 3 * count, room + 5 * count};
    input_job job = {body, g, points, begin, map_place_of(map, g->width, g->height), *in};
    parallel_for(tape_context(t), count, 512, input_range, &job);
    return true;
}

static sherf_status query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb) {
    const nhp_network *n = m->network;
    const nhp_settings *k = nhp_settings_of(&m->config);
    const int64_t count = end - begin;
    tensor *map = bank->tensor[BANK_MAP];
    point_inputs in;
    if (!map || !inputs(t, body, g, map, points, begin, count, &in)) return tape_status(t);
    tensor *f = op_sample_bilinear(t, map, tape_input(t, in.at, 2, (int64_t[]){count, 2}));
    tensor *h = nhp_volume_at(t, k, g, bank->tensor + BANK_LEVEL, in.world, count);
    h = op_relu(t, linear_forward(t, &n->from_volume, h));
    tensor *q = op_relu(t, linear_forward(t, &n->from_pixel, f));
    h = op_add(t, linear_forward(t, &n->volume_value, h), linear_forward(t, &n->pixel_value, q));
    h = op_relu(t, linear_forward(t, &n->hidden, h));
    h = op_relu(t, linear_forward(t, &n->geometry, h));
    tensor *x = op_relu(t, linear_forward(t, &n->density[0], h));
    *sigma = linear_forward(t, &n->density[1], x);
    tensor *c = op_add(t, linear_forward(t, &n->color_geometry, h), linear_forward(t, &n->color_pixel, f));
    tensor *direction = op_positional_encode(t, tape_input(t, in.direction, 2, (int64_t[]){count, 3}),
                                             DIRECTION_FREQUENCIES, DIRECTION_WIDTH);
    x = op_relu(t, linear_forward(t, &n->view, op_concat(t, 2, (tensor *[]){c, direction})));
    x = op_add(t, x, linear_forward(t, &n->view_pixel, f));
    x = op_relu(t, linear_forward(t, &n->last, x));
    *rgb = op_sigmoid(t, linear_forward(t, &n->color, x), 1, 0);
    return tape_status(t);
}

/* ---- the frame: even depths; in the authors' training moved within the halfway points to their neighbours
 * ---- */
static sherf_status frame(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, const target_geometry *target, float background, uint64_t key,
                          tensor **out) {
    const point_set *points = target->points;
    if (!nhp_settings_of(&m->config)->own)
        return model_pass(t, m, body, g, bank, target, points, background, key, NULL, out);
    if (key && !(points = depths_jittered(t, points, last_way, key))) return tape_status(t);
    return model_pass(t, m, body, g, bank, target, points, background, 0, NULL, out);
}

/* ---- arrays that avatars keep: the encoder's stages, the levels and the positions of their voxels ---- */
static void kept(const model_config *config, kept_bank *out) {
    static const char *const stage[] = {"stage.0", "stage.1", "stage.2"};
    static const char *const value[] = {"volume.1.value", "volume.2.value", "volume.3.value",
                                        "volume.4.value"};
    static const char *const voxel[] = {"volume.1.voxel", "volume.2.voxel", "volume.3.voxel",
                                        "volume.4.voxel"};
    const nhp_settings *k = nhp_settings_of(config);
    *out = (kept_bank){0};
    for (int i = 0; i < NHP_STAGES; i++)
        out->array[out->count++] = (kept_array){stage[i], T_F32, 3, {0, 0, k->encoder_width << (i > 1)}};
    for (int l = 0; l < NHP_LEVELS; l++) {
        out->array[out->count++] = (kept_array){value[l], T_F32, 2, {0, k->volume_channels[l]}};
        out->array[out->count++] = (kept_array){voxel[l], T_I32, 1, {0}};
    }
}

static int32_t *voxel_numbers(context *c, const sparse_level *level) {
    int32_t *number = mem_zero(c, (size_t)level->voxels, sizeof *number);
    const int64_t cells = (int64_t)level->size[0] * level->size[1] * level->size[2];
    for (int64_t i = 0; number && i < cells; i++)
        if (level->grid[i] >= 0) number[level->grid[i]] = (int32_t)i;
    return number;
}

static sherf_status keep(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                         kept_bank *out) {
    const nhp_bank *own = bank->own;
    const nhp_geometry *geometry = g->own;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < NHP_STAGES && status == SHERF_OK; i++)
        status = kept_take(c, own->stage[i], &out->array[i]);
    for (int l = 0; l < NHP_LEVELS && status == SHERF_OK; l++) {
        kept_array *value = &out->array[NHP_STAGES + 2 * l], *voxel = value + 1;
        status = kept_take(c, bank->tensor[BANK_LEVEL + l], value);
        voxel->dim[0] = geometry->level[l + 1].voxels;
        voxel->data = voxel_numbers(c, &geometry->level[l + 1]);
        if (!voxel->data) status = SHERF_NO_MEMORY;
    }
    return status;
}

static sherf_status restore(tape *t, const model *m, observation_geometry *g, const kept_bank *arrays,
                            const model_bank *kept_tensors, model_bank *bank) {
    nhp_geometry *own = g->own;
    bank->count = BANK_LEVEL + NHP_LEVELS;
    bank->tensor[BANK_MAP] = stages_side_by_side(t, NHP_STAGES, kept_tensors->tensor);
    for (int l = 0; l < NHP_LEVELS; l++) {
        const kept_array *value = &arrays->array[NHP_STAGES + 2 * l], *voxel = value + 1;
        bank->tensor[BANK_LEVEL + l] = kept_tensors->tensor[NHP_STAGES + 2 * l];
        if (value->dim[0] != voxel->dim[0])
            return failure(tape_context(t), SHERF_BAD_FILE, "tensor %s is missing or of the wrong shape",
                           voxel->name);
        sherf_status status = nhp_level_is(tape_context(t), own, l + 1, voxel->dim[0], voxel->data);
        if (status != SHERF_OK) return status;
    }
    return tape_status(t);
}

const model_kind model_nhp = {.name = "nhp",
                              .presets = presets,
                              .settings = settings,
                              .defaults = defaults,
                              .network_bytes = sizeof(nhp_network),
                              .declare = network_declare,
                              .queried = (const char *const[]){"field.", NULL},
                              .resnets = (const char *const[]){"encoder.", NULL},
                              .observe = nhp_observe,
                              .observed_free = nhp_observed_free,
                              .encode = encode,
                              .query = query,
                              .whole_box = whole_box,
                              .frame = frame,
                              .recipe = recipe,
                              .kept = kept,
                              .keep = keep,
                              .restore = restore};
