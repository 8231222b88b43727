/* PixelNeRF as an entry of the table. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "model/depths.h"
#include "model/pixelnerf/pixelnerf.h"
#include "model/stages.h"

enum { POSITION_FREQUENCIES = 6, POSITION_WIDTH = 39, CODE_WIDTH = POSITION_WIDTH + 3 };
static const float first_frequency = 1.5f, spread_m = 0.01f;

/* ---- settings ---- */
#define SMALL "encoder=18,width=128,passes=1,image_size=256"
#define MATCHED "passes=1,shell=1,own=0,samples=48"
static const model_preset presets[] = {
    {"own", ""}, {"own-small", SMALL}, {"matched", MATCHED}, {"matched-small", SMALL "," MATCHED}, {0}};

#define AT(field) MODEL_SETTING_AT(pixelnerf_settings, field)
static const model_setting settings[] = {{"encoder", AT(encoder), 18, 34, 1},
                                         {"encoder_width", AT(encoder_width), 8, 256, 8},
                                         {"pool", AT(pool), 0, 1, 1},
                                         {"width", AT(width), 8, 1024, 8},
                                         {"passes", AT(passes), 1, PIXELNERF_NETWORKS, 1},
                                         {"drawn", AT(drawn), 0, 32, 1},
                                         {"around", AT(around), 0, 32, 1},
                                         {"shell", AT(shell), 0, 1, 1},
                                         {"own", AT(own), 0, 1, 1},
                                         {0}};

static const pixelnerf_settings *settings_of(const model_config *config) {
    return (const pixelnerf_settings *)config->own.bytes;
}

static void defaults(model_config *out) {
    const pixelnerf_settings own = {.encoder = 34,
                                    .encoder_width = 64,
                                    .pool = 1,
                                    .width = 512,
                                    .passes = 2,
                                    .drawn = 16,
                                    .around = 16,
                                    .own = 1};
    memcpy(out->own.bytes, &own, sizeof own);
    out->samples = 64;
    out->image_size = 512;
}

static sherf_status check(context *c, const model_config *config) {
    const pixelnerf_settings *k = settings_of(config);
    if (k->own && k->shell)
        return failure(c, SHERF_BAD_ARGUMENT,
                       "model setting shell=1: is for own=0, as the authors' PixelNeRF knows no body");
    if (k->passes == 2 && !k->own)
        return failure(c, SHERF_BAD_ARGUMENT, "model setting passes=2: is for own=1, with depths by chance");
    return encoder_check(c, k->encoder);
}

static bool whole_box(const model_config *config) {
    return !settings_of(config)->shell;
}

/* 4 objects of 128 rays a step, Adam of 1e-4. */
static const training_recipe *recipe(const model_config *config) {
    static const training_recipe own = {
        .rays = 128, .batch = 4, .learning_rate = 1e-4, .beta1 = 0.9, .beta2 = 0.999};
    return settings_of(config)->own ? &own : NULL;
}

/* ---- parameters ---- */
static void field_declare(declaration *d, const char *name, const pixelnerf_settings *k, pixelnerf_field *f) {
    const int64_t W = k->width, L = 8 * (int64_t)k->encoder_width; /* 1 + 1 + 2 + 4 widths */
    char full[LAYER_NAME];
    snprintf(full, sizeof full, "%s.in", name);
    f->in = linear_declare(d, full, true, W, CODE_WIDTH);
    for (int i = 0; i < PIXELNERF_FED; i++) {
        snprintf(full, sizeof full, "%s.feature.%d", name, i);
        f->feature[i] = linear_declare(d, full, true, W, L);
    }
    for (int i = 0; i < PIXELNERF_BLOCKS; i++) {
        snprintf(full, sizeof full, "%s.block.%d.0", name, i);
        f->block[i].fc[0] = linear_declare(d, full, true, W, W);
        /* a block begins as the identity */
        f->block[i].fc[1] =
            (linear_layer){declare(d, (first_values){0}, DIMS(W, W), "%s.block.%d.1.weight", name, i),
                           declare(d, (first_values){0}, DIMS(W), "%s.block.%d.1.bias", name, i)};
    }
    snprintf(full, sizeof full, "%s.out", name);
    f->out = linear_declare(d, full, true, 4, W);
}

static void network_declare(declaration *d, const model_config *config, void *network) {
    static const char *const name[PIXELNERF_NETWORKS] = {"coarse", "fine"};
    pixelnerf_network *n = network;
    const pixelnerf_settings *k = settings_of(config);
    resnet_declare(d, "encoder", k->encoder, k->encoder_width, PIXELNERF_STAGES - 1, &n->encoder);
    for (int i = 0; i < k->passes; i++) field_declare(d, name[i], k, &n->field[i]);
}

/* ---- the observation: the middle of its body's box ---- */
static sherf_status observe(context *c, const model_config *config, const body_model *body, bool training,
                            observation_geometry *g) {
    float *middle = mem_alloc(c, 3, sizeof *middle), min[3], max[3];
    if (!middle) return SHERF_NO_MEMORY;
    body_world_box(body, g->body, min, max);
    for (int k = 0; k < 3; k++) middle[k] = (min[k] + max[k]) / 2;
    g->own = middle;
    return SHERF_OK;
}

static void observed_free(void *own) {
    mem_free(own);
}

/* ---- encode ---- */
/* A linear layer and bilinear sampling commute where no neighbour is outside the map, as here. So the layers
 * that feed features in are applied once per picture, not once per point. */
static sherf_status maps(tape *t, const model *m, tensor *const stage[PIXELNERF_STAGES], model_bank *bank) {
    const pixelnerf_network *n = m->network;
    tape *work = tape_for_parts(t);
    if (!work) return tape_status(t);
    tensor *side_by_side = tape_keep(t, work, stages_side_by_side(work, PIXELNERF_STAGES, stage));
    bank->count = 0;
    for (int i = 0; i < settings_of(&m->config)->passes; i++)
        for (int f = 0; f < PIXELNERF_FED; f++)
            bank->tensor[bank->count++] = linear_forward(t, &n->field[i].feature[f], side_by_side);
    return tape_status(t);
}

static sherf_status encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank) {
    const pixelnerf_network *n = m->network;
    const shift_scale_attr from_middle = {.shift = {0.5f, 0.5f, 0.5f}, .scale = {0.5f, 0.5f, 0.5f}};
    pixelnerf_bank *own = tape_alloc(t, 1, sizeof *own);
    if (!own) return tape_status(t);
    *own = (pixelnerf_bank){0};
    bank->own = own;
    tensor *image = tape_input(t, g->image, 3, (int64_t[]){g->height, g->width, 3});
    tensor *x = resnet_stem(t, &n->encoder, op_shift_scale(t, image, &from_middle));
    own->stage[0] = x;
    if (settings_of(&m->config)->pool) x = op_max_pool(t, x, 3, 2, 1);
    for (int i = 1; i < PIXELNERF_STAGES; i++) own->stage[i] = x = resnet_stage(t, &n->encoder, i, x);
    return maps(t, m, own->stage, bank);
}

/* ---- query ---- */
typedef struct {
    float *position, *warped, *direction,
        *at; /* [P, 3] three times, the second times 1.5; [P, 2] in the map */
} point_inputs;

typedef struct {
    const observation_geometry *g;
    const point_set *points;
    int64_t begin;
    map_place place;
    point_inputs in;
} input_job;

static void turned(const float R[9], const float v[3], float out[3]) {
    for (int k = 0; k < 3; k++) out[k] = R[3 * k] * v[0] + R[3 * k + 1] * v[1] + R[3 * k + 2] * v[2];
}

static void input_range(void *arg, int64_t begin, int64_t end, int thread) {
    const input_job *j = arg;
    const float *middle = j->g->own, *R = j->g->camera.R;
    for (int64_t i = begin; i < end; i++) {
        const float *d = j->points->on->direction + 3 * (int64_t)j->points->ray[j->begin + i];
        const float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        float x[3], from[3], unit[3], px[2];
        point_world(j->points, j->begin + i, x);
        camera_project(&j->g->camera, 1, x, px, NULL);
        for (int k = 0; k < 3; k++) from[k] = x[k] - middle[k], unit[k] = d[k] / length;
        turned(R, from, j->in.position + 3 * i);
        turned(R, unit, j->in.direction + 3 * i);
        for (int k = 0; k < 3; k++) j->in.warped[3 * i + k] = first_frequency * j->in.position[3 * i + k];
        map_position(&j->place, px, j->in.at + 2 * i);
    }
}

static bool inputs(tape *t, const observation_geometry *g, const tensor *map, const point_set *points,
                   int64_t begin, int64_t count, point_inputs *in) {
    float *room = tape_alloc(t, (size_t)count + 1, 11 * sizeof *room);
    if (!room) return false;
    *in = (point_inputs){room, room + 3 * count, room + 6 * count, room + 9 * count};
    input_job job = {
        .g = g, .points = points, .begin = begin, .place = map_place_of(map, g->width, g->height), .in = *in};
    parallel_for(tape_context(t), count, 1024, input_range, &job);
    return true;
}

/* [P, 42]: position, its encoding from frequency 1.5 on, unit direction; in the input camera's axes. */
static tensor *code(tape *t, const point_inputs *in, int64_t count) {
    const int64_t shape[2] = {count, 3};
    tensor *waves =
        op_positional_encode(t, tape_input(t, in->warped, 2, shape), POSITION_FREQUENCIES, POSITION_WIDTH);
    return op_concat(t, 3,
                     (tensor *[]){tape_input(t, in->position, 2, shape),
                                  op_slice(t, waves, 3, POSITION_WIDTH - 3),
                                  tape_input(t, in->direction, 2, shape)});
}

static sherf_status query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb) {
    const pixelnerf_bank *own = bank->own;
    const pixelnerf_network *n = m->network;
    const pixelnerf_field *f = &n->field[own ? own->network : 0];
    const int64_t count = end - begin;
    point_inputs in;
    if (!bank->tensor[0] || !inputs(t, g, bank->tensor[0], points, begin, count, &in)) return tape_status(t);
    tensor *at = tape_input(t, in.at, 2, (int64_t[]){count, 2});
    tensor *h = linear_forward(t, &f->in, code(t, &in, count));
    for (int i = 0; i < PIXELNERF_BLOCKS; i++) {
        if (i < PIXELNERF_FED) h = op_add(t, h, op_sample_bilinear(t, bank->tensor[i], at));
        tensor *x = linear_forward(t, &f->block[i].fc[0], op_relu(t, h));
        h = op_add(t, h, linear_forward(t, &f->block[i].fc[1], op_relu(t, x)));
    }
    tensor *y = linear_forward(t, &f->out, op_relu(t, h));
    *rgb = op_sigmoid(t, op_slice(t, y, 0, 3), 1, 0);
    *sigma = op_slice(t, y, 3, 1);
    return tape_status(t);
}

/* ---- the frame ---- */
static sherf_status frame(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, const target_geometry *target, float background, uint64_t key,
                          tensor **out) {
    const pixelnerf_settings *k = settings_of(&m->config);
    tensor *sigma, *seen;
    if (!k->own) return model_pass(t, m, body, g, bank, target, target->points, background, key, NULL, out);
    const point_set *coarse = depths_stratified(t, target->points, key);
    if (!coarse) return tape_status(t);
    sherf_status status = model_pass(t, m, body, g, bank, target, coarse, background, 0, &sigma, &seen);
    *out = seen;
    if (status != SHERF_OK || k->passes == 1) return status;
    const point_set *fine = depths_fine(t, coarse, sigma, (fine_draw){k->drawn, k->around, spread_m}, key);
    pixelnerf_bank *own = tape_alloc(t, 1, sizeof *own);
    if (!fine || !own) return tape_status(t);
    *own = (pixelnerf_bank){.network = 1};
    model_bank second = {.count = PIXELNERF_FED, .own = own};
    for (int i = 0; i < PIXELNERF_FED; i++) second.tensor[i] = bank->tensor[PIXELNERF_FED + i];
    bank->coarse = seen;
    return model_pass(t, m, body, g, &second, target, fine, background, 0, NULL, out);
}

/* ---- arrays that avatars keep: the stages, which take a thirtieth of the maps' memory ---- */
static void kept(const model_config *config, kept_bank *out) {
    static const char *const name[PIXELNERF_STAGES] = {"stage.0", "stage.1", "stage.2", "stage.3"};
    const int64_t width = settings_of(config)->encoder_width;
    *out = (kept_bank){.count = PIXELNERF_STAGES};
    for (int i = 0; i < PIXELNERF_STAGES; i++)
        out->array[i] = (kept_array){name[i], T_F32, 3, {0, 0, i ? width << (i - 1) : width}};
}

static sherf_status keep(context *c, const model *m, const observation_geometry *g, const model_bank *bank,
                         kept_bank *out) {
    const pixelnerf_bank *own = bank->own;
    sherf_status status = SHERF_OK;
    for (int i = 0; i < PIXELNERF_STAGES && status == SHERF_OK; i++)
        status = kept_take(c, own->stage[i], &out->array[i]);
    return status;
}

static sherf_status restore(tape *t, const model *m, observation_geometry *g, const kept_bank *arrays,
                            const model_bank *stages, model_bank *bank) {
    return maps(t, m, stages->tensor, bank);
}

const model_kind model_pixelnerf = {.name = "pixelnerf",
                                    .presets = presets,
                                    .settings = settings,
                                    .defaults = defaults,
                                    .check = check,
                                    .network_bytes = sizeof(pixelnerf_network),
                                    .declare = network_declare,
                                    .queried = (const char *const[]){"coarse.", "fine.", NULL},
                                    .resnets = (const char *const[]){"encoder.", NULL},
                                    .observe = observe,
                                    .observed_free = observed_free,
                                    .encode = encode,
                                    .query = query,
                                    .one_pose = true,
                                    .whole_box = whole_box,
                                    .frame = frame,
                                    .recipe = recipe,
                                    .kept = kept,
                                    .keep = keep,
                                    .restore = restore};
