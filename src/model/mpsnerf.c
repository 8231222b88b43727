/* MPS-NeRF of one picture (Gao et al., TPAMI 2022), a rival of SHERF, which took its decoder and its map to
 * canonical space from this model: pixel-aligned features alone (docs/rivals.md). */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "model/stages.h"
#include "nn/resnet.h"

/* Settings; the paper's in brackets. */
typedef struct {
    int encoder;             /* layers of the ResNet, of which the stem and one stage are used [34] */
    int encoder_width;       /* channels of its stem [64] */
    int layers, value_width; /* of the transformer over views, here a single one [2, 4 heads of 64] */
    int mlp_width;           /* [128] */
    int width, view_width;   /* of the decoder [256 128] */
    int own; /* 1: trained as its authors do, density by softplus; 0: trained as SHERF is, with ReLU [1] */
} mpsnerf_settings;

enum {
    LAYERS_MAX = 8,
    COLOR_FREQUENCIES = 4,
    COLOR_WIDTH = 27,
    POSITION_FREQUENCIES = 6,
    POSITION_WIDTH = 39,
    DEPTH = 8,
    SKIP = 4
};

typedef struct {
    resnet encoder;
    struct {
        layer_norm norm[2];
        tensor *value; /* [value_width, point features]; with one view its weight is 1, whatever keys and
                          queries are */
        linear_layer out, mlp[2];
    } layer[LAYERS_MAX];
    linear_layer hidden[DEPTH], density, feature, view, color;
} mpsnerf_network;

/* ---- settings ---- */
#define SMALL "encoder=18,width=128,view_width=64,image_size=256"
#define MATCHED "own=0,samples=48"
static const model_preset presets[] = {
    {"own", ""}, {"own-small", SMALL}, {"matched", MATCHED}, {"matched-small", SMALL "," MATCHED}, {0}};

#define AT(field) MODEL_SETTING_AT(mpsnerf_settings, field)
static const model_setting settings[] = {{"encoder", AT(encoder), 18, 34, 1},
                                         {"encoder_width", AT(encoder_width), 8, 256, 8},
                                         {"layers", AT(layers), 0, LAYERS_MAX, 1},
                                         {"value_width", AT(value_width), 8, 1024, 8},
                                         {"mlp_width", AT(mlp_width), 8, 1024, 8},
                                         {"width", AT(width), 8, 1024, 8},
                                         {"view_width", AT(view_width), 8, 1024, 8},
                                         {"own", AT(own), 0, 1, 1},
                                         {0}};

static const mpsnerf_settings *settings_of(const model_config *config) {
    return (const mpsnerf_settings *)config->own.bytes;
}

static void defaults(model_config *out) {
    const mpsnerf_settings own = {.encoder = 34,
                                  .encoder_width = 64,
                                  .layers = 2,
                                  .value_width = 256,
                                  .mlp_width = 128,
                                  .width = 256,
                                  .view_width = 128,
                                  .own = 1};
    memcpy(out->own.bytes, &own, sizeof own);
    out->samples = 128;
    out->image_size = 512;
}

static sherf_status check(context *c, const model_config *config) {
    return encoder_check(c, settings_of(config)->encoder);
}

/* 1000 rays of each of two targets a step, 80 % of them from the mask. */
static const training_recipe *recipe(const model_config *config) {
    static const training_recipe own = {.mask_weight = 1,
                                        .rays = 1000,
                                        .rays_inside = 0.8f,
                                        .jitter = true,
                                        .batch = 2,
                                        .learning_rate = 5e-4,
                                        .beta1 = 0.9,
                                        .beta2 = 0.999,
                                        .halve_every = 30000};
    return settings_of(config)->own ? &own : NULL;
}

/* ---- parameters ---- */
static void fusion_declare(declaration *d, const mpsnerf_settings *k, int64_t width, mpsnerf_network *n) {
    char name[LAYER_NAME];
    for (int i = 0; i < k->layers; i++) {
        for (int half = 0; half < 2; half++) {
            snprintf(name, sizeof name, "fusion.%d.norm.%d", i, half);
            n->layer[i].norm[half] = layer_norm_declare(d, name, width);
            snprintf(name, sizeof name, "fusion.%d.mlp.%d", i, half);
            n->layer[i].mlp[half] =
                linear_declare(d, name, false, half ? width : k->mlp_width, half ? k->mlp_width : width);
        }
        snprintf(name, sizeof name, "fusion.%d.value", i);
        n->layer[i].value = declare_weights(d, false, DIMS(k->value_width, width), name);
        snprintf(name, sizeof name, "fusion.%d.out", i);
        n->layer[i].out = linear_declare(d, name, false, width, k->value_width);
    }
}

static void network_declare(declaration *d, const model_config *config, void *network) {
    mpsnerf_network *n = network;
    const mpsnerf_settings *k = settings_of(config);
    const int64_t W = k->width, point = 2 * (int64_t)k->encoder_width + COLOR_WIDTH,
                  x = POSITION_WIDTH + point;
    char name[LAYER_NAME];
    resnet_declare(d, "encoder", k->encoder, k->encoder_width, 1, &n->encoder);
    fusion_declare(d, k, point, n);
    for (int i = 0; i < DEPTH; i++) {
        snprintf(name, sizeof name, "decoder.hidden.%d", i);
        n->hidden[i] = linear_declare(d, name, true, W, i == 0 ? x : i == SKIP + 1 ? W + x : W);
    }
    n->density = linear_declare(d, "decoder.density", false, 1, W);
    n->feature = linear_declare(d, "decoder.feature", false, W, W);
    n->view = linear_declare(d, "decoder.view", true, k->view_width, W + point);
    n->color = linear_declare(d, "decoder.color", false, 3, k->view_width);
}

/* ---- encode ---- */
/* Halves the size; each pixel is the mean of four. */
static tensor *halved(tape *t, tensor *image) {
    const int64_t height = image->dim[0] / 2, width = image->dim[1] / 2;
    float *at = tape_alloc(t, (size_t)(height * width), 2 * sizeof *at);
    if (!at) return NULL;
    for (int64_t i = 0; i < height * width; i++) {
        at[2 * i] = 2 * (float)(i % width) + 0.5f;
        at[2 * i + 1] = 2 * (float)(i / width) + 0.5f;
    }
    tensor *y = op_sample_bilinear(t, image, tape_input(t, at, 2, (int64_t[]){height * width, 2}));
    return y ? tape_reshape(t, y, 3, (int64_t[]){height, width, 3}) : NULL;
}

static sherf_status encode(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                           model_bank *bank) {
    const mpsnerf_network *n = m->network;
    tape *work = tape_for_parts(t);
    if (!work) return tape_status(t);
    tensor *image = tape_input(work, g->image, 3, (int64_t[]){g->height, g->width, 3});
    tensor *stem = image ? resnet_stem(work, &n->encoder, halved(work, image)) : NULL;
    tensor *stage = resnet_stage(work, &n->encoder, 1, stem);
    bank->tensor[bank->count++] = tape_keep(t, work, op_concat(work, 2, (tensor *[]){stem, stage}));
    return tape_status(t);
}

/* ---- query ---- */
/* Pixel (u, v) of a W x H picture is at (u / W (W_f - 1), v / H (H_f - 1)) in a map, clamped to it. */
static tensor *positions(tape *t, const float *px, int64_t count, const observation_geometry *g,
                         int64_t height, int64_t width) {
    float *at = tape_alloc(t, (size_t)count + 1, 2 * sizeof *at);
    if (!at) return NULL;
    const float right = (float)(width - 1), bottom = (float)(height - 1);
    for (int64_t i = 0; i < count; i++) {
        at[2 * i] = fminf(fmaxf(px[2 * i] / (float)g->width * right, 0), right); /* NaN becomes 0 */
        at[2 * i + 1] = fminf(fmaxf(px[2 * i + 1] / (float)g->height * bottom, 0), bottom);
    }
    return tape_input(t, at, 2, (int64_t[]){count, 2});
}

/* x, then sin(2^k pi x) and sin(2^k pi x + pi/2). */
static tensor *encode_pi(tape *t, tensor *x, int frequencies, int64_t width) {
    tensor *waves = op_positional_encode(t, op_scale(t, x, (float)M_PI), frequencies, width);
    return op_concat(t, 2, (tensor *[]){x, op_slice(t, waves, 3, width - 3)});
}

/* Map features and colour at the points' pixels in the observation. */
static tensor *features(tape *t, const observation_geometry *g, tensor *map, const float *px, int64_t count) {
    const int64_t shape[3] = {g->height, g->width, 3};
    tensor *image = tape_constant(t, T_F32, 3, shape, g->image);
    if (!map || !image) return NULL;
    tensor *feature = op_sample_bilinear(t, map, positions(t, px, count, g, map->dim[0], map->dim[1]));
    tensor *rgb = op_sample_bilinear(t, image, positions(t, px, count, g, g->height, g->width));
    return op_concat(t, 2, (tensor *[]){feature, encode_pi(t, rgb, COLOR_FREQUENCIES, COLOR_WIDTH)});
}

/* Pre-norm layers over the views: with one view attention returns the value itself. */
static tensor *fused(tape *t, const mpsnerf_network *n, int layers, tensor *x) {
    for (int i = 0; i < layers; i++) {
        tensor *y =
            op_linear(t, layer_norm_forward(t, &n->layer[i].norm[0], x), n->layer[i].value, NULL, 1, 1);
        x = op_add(t, x, linear_forward(t, &n->layer[i].out, y));
        y = linear_forward(t, &n->layer[i].mlp[0], layer_norm_forward(t, &n->layer[i].norm[1], x));
        x = op_add(t, x, linear_forward(t, &n->layer[i].mlp[1], op_gelu(t, y)));
    }
    return x;
}

static sherf_status query(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          const model_bank *bank, const point_set *points, int64_t begin, int64_t end,
                          tensor **sigma, tensor **rgb) {
    const mpsnerf_network *n = m->network;
    const mpsnerf_settings *k = settings_of(&m->config);
    const int64_t count = end - begin;
    tensor *token = features(t, g, bank->tensor[0], points->observed_px + 2 * begin, count);
    token = fused(t, n, k->layers, token);
    tensor *position = tape_input(t, points->canonical + 3 * begin, 2, (int64_t[]){count, 3});
    tensor *x =
        op_concat(t, 2, (tensor *[]){encode_pi(t, position, POSITION_FREQUENCIES, POSITION_WIDTH), token});
    tensor *h = x;
    for (int i = 0; i < DEPTH; i++) {
        h = op_relu(t, linear_forward(t, &n->hidden[i], h));
        if (i == SKIP) h = op_concat(t, 2, (tensor *[]){x, h});
    }
    *sigma = linear_forward(t, &n->density, h);
    if (k->own) *sigma = op_softplus(t, *sigma, -1);
    h = op_concat(t, 2, (tensor *[]){linear_forward(t, &n->feature, h), token});
    h = op_relu(t, linear_forward(t, &n->view, h));
    *rgb = op_sigmoid(t, linear_forward(t, &n->color, h), 1.0002f, -0.0001f);
    return tape_status(t);
}

/* The authors add no noise to densities. */
static sherf_status frame(tape *t, const model *m, const body_model *body, const observation_geometry *g,
                          model_bank *bank, const target_geometry *target, float background, uint64_t key,
                          tensor **out) {
    return model_pass(t, m, body, g, bank, target, target->points, background,
                      settings_of(&m->config)->own ? 0 : key, NULL, out);
}

static void kept(const model_config *config, kept_bank *out) {
    *out = (kept_bank){1, {{"map", T_F32, 3, {0, 0, 2 * settings_of(config)->encoder_width}}}};
}

const model_kind model_mpsnerf = {.name = "mps-nerf",
                                  .presets = presets,
                                  .settings = settings,
                                  .defaults = defaults,
                                  .check = check,
                                  .network_bytes = sizeof(mpsnerf_network),
                                  .declare = network_declare,
                                  .reads_observed_px = true,
                                  .queried = (const char *const[]){"fusion.", "decoder.", NULL},
                                  .resnets = (const char *const[]){"encoder.", NULL},
                                  .encode = encode,
                                  .query = query,
                                  .frame = frame,
                                  .recipe = recipe,
                                  .kept = kept};
